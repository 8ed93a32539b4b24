"""Images survive being written and read; what is no image is refused by name."""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image as PillowImage

from compare.measure.image import Image, ImageError, read_image, write_display, write_exr

WIDTH, HEIGHT = 7, 5


def picture(seed: int = 40) -> Image:
    """float32 values, so that 32-bit files hold them exactly."""
    generator = np.random.default_rng(seed)
    values = generator.random((2, HEIGHT, WIDTH, 3)).astype(np.float32)
    header = {"sceneHash": "0123456789abcdef", "lightSamples": 64, "renderSeconds": 0.25}
    return Image((values[0] - np.float32(0.25)).astype(float), values[1].astype(float), header)


def pfm(values: np.ndarray, scale: str = "-1.0", kind: str = "PF") -> bytes:
    height, width = values.shape[:2]
    order = "<f4" if scale.startswith("-") else ">f4"
    return f"{kind}\n{width} {height}\n{scale}\n".encode() + values[::-1].astype(order).tobytes()


def save(file: Path, image: Image) -> None:
    if file.suffix == ".exr":
        write_exr(file, image)
    elif file.suffix == ".pfm":
        file.write_bytes(pfm(image.radiance))
    else:
        write_display(file, image.radiance)


def test_an_exr_gives_back_what_was_written_bit_for_bit(tmp_path: Path) -> None:
    image = picture()
    write_exr(tmp_path / "a.exr", image)
    again = read_image(tmp_path / "a.exr")
    assert again.variance is not None and image.variance is not None
    assert (again.radiance == image.radiance).all()
    assert (again.variance == image.variance).all()
    assert again.shape == (HEIGHT, WIDTH)
    assert image.attributes.items() <= again.attributes.items()
    write_exr(tmp_path / "b.exr", again)  # what was read can be written again, header and all
    assert read_image(tmp_path / "b.exr").attributes == again.attributes


def test_an_exr_without_variance_has_none(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", Image(picture().radiance))
    assert read_image(tmp_path / "a.exr").variance is None


def test_channels_of_half_floats_are_read(tmp_path: Path) -> None:
    """2^-11 relative: half a unit in the last of a half float's 11 bits."""
    radiance = picture().radiance
    channels = {c: radiance[..., i].astype(np.float16) for i, c in enumerate("RGB")}
    OpenEXR.File({}, channels).write(str(tmp_path / "half.exr"))
    assert read_image(tmp_path / "half.exr").radiance == pytest.approx(radiance, rel=2**-11)


@pytest.mark.parametrize("scale", ["-1.0", "1.0"])
def test_a_pfm_of_either_byte_order_starts_at_the_bottom(scale: str, tmp_path: Path) -> None:
    radiance = picture().radiance
    (tmp_path / "a.pfm").write_bytes(pfm(radiance, scale))
    assert (read_image(tmp_path / "a.pfm").radiance == radiance).all()


def test_a_display_png_is_the_labs_clamped_and_truncated_value(tmp_path: Path) -> None:
    """0.999 * 255 = 254.7 is 254, not 255; below 0 and above 1 is cut."""
    values = np.array([-0.5, 0, 0.001, 0.5, 0.999, 1, 7])
    radiance = np.broadcast_to(values[None, :, None], (HEIGHT, WIDTH, 3))
    write_display(tmp_path / "a.png", radiance)
    assert list(np.asarray(PillowImage.open(tmp_path / "a.png"))[0, :, 0]) == [
        *(0, 0, 0, 127, 254, 255, 255)
    ]


def test_an_eight_bit_picture_is_known_to_half_a_level(tmp_path: Path) -> None:
    """v stands for (v + 1/2) / 255: at most 1/510 off below 1, and exactly that at 0."""
    radiance = np.random.default_rng(41).random((50, 70, 3))
    write_display(tmp_path / "a.png", radiance)
    error = np.abs(read_image(tmp_path / "a.png").radiance - radiance)
    assert 1 / 510 * 0.95 < error.max() <= 1 / 510 + 1e-12


def test_a_display_jpg_keeps_the_labs_colours(tmp_path: Path) -> None:
    """Red floor beside blue sphere: with colour at half the resolution, as libraries save by
    default, the border would bleed by 60 levels. At quality 100 a level or two is all."""
    radiance = np.zeros((16, 16, 3))
    radiance[:, :7, 0] = radiance[:, 7:, 2] = 0.8
    write_display(tmp_path / "a.jpg", radiance)
    assert np.abs(read_image(tmp_path / "a.jpg").radiance - radiance).max() < 4 / 255


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm"])
def test_a_file_cut_short_is_refused_unless_all_its_pixels_are_there(
    suffix: str, tmp_path: Path
) -> None:
    """Cut at every byte. A PNG ends in 20 bytes of checksums and end mark, a JPG in 2, that no
    pixel needs."""
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    save(whole, picture())
    data = whole.read_bytes()
    tail = {"png": 20, "jpg": 2}.get(suffix, 0)
    for length in range(len(data) - tail):
        cut.write_bytes(data[:length])
        with pytest.raises(ImageError, match=rf"cut\.{suffix}: "):
            read_image(cut)


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm"])
def test_any_other_file_under_an_images_name_is_refused(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"x.{suffix}"
    for content in (b"", b"{}", os.urandom(2000), b"PF\n" * 300, b"\0" * 5000):
        file.write_bytes(content)
        with pytest.raises(ImageError, match=rf"x\.{suffix}"):
            read_image(file)


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm"])
def test_a_damaged_file_is_read_or_refused_but_never_crashes(suffix: str, tmp_path: Path) -> None:
    """300 files with up to five bytes changed; nothing but ImageError may come out."""
    file = tmp_path / f"x.{suffix}"
    save(file, picture())
    data = file.read_bytes()
    generator = np.random.default_rng(42)
    for _ in range(300):
        damaged = bytearray(data)
        for place in generator.integers(0, len(data), 5):
            damaged[place] = generator.integers(0, 256)
        file.write_bytes(damaged)
        try:
            again = read_image(file)
        except ImageError:
            continue
        assert again.radiance.ndim == 3 and np.isfinite(again.radiance).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_are_refused_with_their_first_pixel(bad: float, tmp_path: Path) -> None:
    radiance = picture().radiance
    radiance[2, 3, 1] = radiance[4, 0, 0] = bad
    (tmp_path / "a.pfm").write_bytes(pfm(radiance))
    with pytest.raises(ImageError, match=r"a\.pfm: 2 pixels are NaN or infinite, .* \(3, 2\)"):
        read_image(tmp_path / "a.pfm")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_a_variance_that_is_none_is_refused(bad: float, tmp_path: Path) -> None:
    channels = {c: np.ones((HEIGHT, WIDTH), np.float32) for c in "RGB"}
    variance = {f"variance.{c}": np.full((HEIGHT, WIDTH), bad, np.float32) for c in "RGB"}
    OpenEXR.File({}, channels | variance).write(str(tmp_path / "a.exr"))
    with pytest.raises(ImageError, match=r"a\.exr: a variance"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("channels", "missing"),
    [("RG", "B"), ("Y", "R, G, B"), ("RGB variance.R variance.G", r"variance\.B")],
)
def test_a_missing_channel_is_named(channels: str, missing: str, tmp_path: Path) -> None:
    first, *rest = channels.split()
    plane = np.ones((HEIGHT, WIDTH), np.float32)
    OpenEXR.File({}, {name: plane for name in [*first, *rest]}).write(str(tmp_path / "a.exr"))
    with pytest.raises(ImageError, match=rf"a\.exr: has no channel {missing}$"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (pfm(np.ones((2, 2, 3)), kind="Pf"), "not a colour PFM"),
        (pfm(np.ones((2, 2, 3)), scale="0"), "not a colour PFM"),
        (pfm(np.ones((2, 2, 3)), scale="nan"), "not a colour PFM"),
        (b"PF\n-2 -2\n-1\n" + bytes(48), "48 bytes of pixels"),
        (b"PF\n999999999 999999999\n-1\n" + bytes(48), "48 bytes of pixels"),
        (b"PF\n2 2\nlittle\n" + bytes(48), "cannot be read"),
    ],
)
def test_a_pfm_whose_header_lies_is_refused(content: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.pfm").write_bytes(content)
    with pytest.raises(ImageError, match=rf"a\.pfm: .*{reason}"):
        read_image(tmp_path / "a.pfm")


def test_a_picture_of_more_than_eight_bits_is_refused(tmp_path: Path) -> None:
    """Converted to 8 bits it would be white all over."""
    PillowImage.fromarray(np.full((4, 4), 40000, np.uint16)).save(tmp_path / "deep.png")
    with pytest.raises(ImageError, match=r"deep\.png: I;16"):
        read_image(tmp_path / "deep.png")


def test_an_enormous_picture_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    """A PNG of 60000 x 60000 pixels in 100 bytes."""
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + check

    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    (tmp_path / "bomb.png").write_bytes(data)
    with pytest.raises(ImageError, match=r"bomb\.png"):
        read_image(tmp_path / "bomb.png")


@pytest.mark.parametrize("name", ["nothing.exr", ".", "folder.exr"])
def test_what_is_no_file_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(ImageError, match="no such file"):
        read_image(tmp_path / name)


def test_an_unknown_suffix_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(b"II*")
    with pytest.raises(ImageError, match=r"a\.tif: not an \.exr"):
        read_image(tmp_path / "a.tif")
    with pytest.raises(ImageError, match=r"a\.tif: a picture's name"):
        write_display(tmp_path / "a.tif", picture().radiance)


Write = Callable[[Path, np.ndarray], None]


def as_exr(file: Path, radiance: np.ndarray) -> None:
    write_exr(file.with_suffix(".exr"), Image(radiance))


@pytest.mark.parametrize("write", [as_exr, write_display])
def test_what_cannot_be_read_again_is_not_written(write: Write, tmp_path: Path) -> None:
    for bad in (math.nan, math.inf):
        radiance = picture().radiance
        radiance[0, 0, 0] = bad
        with pytest.raises(ImageError, match="not written"):
            write(tmp_path / "a.png", radiance)
    assert list(tmp_path.iterdir()) == []


def test_a_radiance_beyond_float32_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="beyond float32"):
        write_exr(tmp_path / "a.exr", Image(np.full((2, 2, 3), 1e39)))


@pytest.mark.parametrize("write", [as_exr, write_display])
def test_a_write_that_fails_leaves_the_old_file_and_no_half_one(
    write: Write, tmp_path: Path
) -> None:
    """The folder is a file, or the target is a folder that cannot be replaced."""
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ImageError, match=r"cannot be written"):
        write(tmp_path / "file" / "a.png", picture().radiance)
    for suffix in (".png", ".exr"):
        (tmp_path / f"a{suffix}").mkdir()
    with pytest.raises(ImageError, match=r"a\.(png|exr): cannot be written"):
        write(tmp_path / "a.png", picture().radiance)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.exr", "a.png", "file"]


def test_threads_that_read_do_not_take_the_output_away(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """OpenEXR is silenced by pointing descriptors 1 and 2 elsewhere for a while."""
    write_exr(tmp_path / "a.exr", picture())
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(read_image, [tmp_path / "a.exr"] * 200))
    os.write(1, b"still here")
    os.write(2, b"and here")
    assert capfd.readouterr() == ("still here", "and here")
