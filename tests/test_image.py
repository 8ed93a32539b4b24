"""Images survive being written and read; what is no image is refused by name."""

from __future__ import annotations

import itertools
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

from penumbra.compare.measure.image import Image, ImageError, read_image, write_display, write_exr

WIDTH, HEIGHT = 9, 5


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


def hdr(radiance: np.ndarray, packed: bool = True, header: bytes = b"") -> bytes:
    """As Ward's rgbe.c writes it: truncated bytes; in runs of equal ones or not."""
    largest = radiance.max(axis=-1, keepdims=True)
    _, exponent = np.frexp(largest)
    scaled = np.ldexp(np.maximum(radiance, 0), 8 - exponent)
    exponent = np.where(largest > 0, exponent + 128, 0)
    pixels = np.concatenate([scaled, exponent], axis=-1).astype(np.uint8)
    height, width, _ = radiance.shape
    packed = packed and width >= 8  # so the format wants it
    data = b"".join(packed_row(row) for row in pixels) if packed else pixels.tobytes()
    size = f"\n-Y {height} +X {width}\n".encode()
    return b"#?RADIANCE\n" + header + b"FORMAT=32-bit_rle_rgbe\n" + size + data


def packed_row(row: np.ndarray) -> bytes:
    """Runs of equal bytes as such, single ones as they are."""
    packed = bytes((2, 2, *divmod(len(row), 256)))
    for plane in row.T:
        for value, group in itertools.groupby(plane.tolist()):
            run = len(list(group))
            for start in range(0, run, 127):
                length = min(127, run - start)
                packed += bytes((128 + length, value) if length > 1 else (1, value))
    return packed


def save(file: Path, image: Image) -> None:
    if file.suffix == ".exr":
        write_exr(file, image)
    elif file.suffix == ".pfm":
        file.write_bytes(pfm(image.radiance))
    elif file.suffix == ".hdr":
        file.write_bytes(hdr(image.radiance))
    elif file.suffix == ".bmp":
        PillowImage.fromarray((255 * image.radiance.clip(0, 1)).astype(np.uint8)).save(file)
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
    radiance = np.broadcast_to(values[None, :, None], (HEIGHT, len(values), 3))
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


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm", "hdr", "bmp"])
def test_a_file_cut_short_is_refused_unless_all_its_pixels_are_there(
    suffix: str, tmp_path: Path
) -> None:
    """Cut at every byte. A PNG ends in 20 bytes of checksums and end mark, a JPG in 2, a
    BMP's row in one that fills it up to a multiple of 4, that no pixel needs."""
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    save(whole, picture())
    data = whole.read_bytes()
    tail = {"png": 20, "jpg": 2, "bmp": 1}.get(suffix, 0)
    for length in range(len(data) - tail):
        cut.write_bytes(data[:length])
        with pytest.raises(ImageError, match=rf"cut\.{suffix}: "):
            read_image(cut)


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm", "hdr", "bmp"])
def test_any_other_file_under_an_images_name_is_refused(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"x.{suffix}"
    for content in (b"", b"{}", os.urandom(2000), b"PF\n" * 300, b"\0" * 5000):
        file.write_bytes(content)
        with pytest.raises(ImageError, match=rf"x\.{suffix}"):
            read_image(file)


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "pfm", "hdr", "bmp"])
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


def chunk(kind: bytes, data: bytes) -> bytes:
    """Of a PNG."""
    check = struct.pack(">I", zlib.crc32(kind + data))
    return struct.pack(">I", len(data)) + kind + data + check


def deep_png(values: np.ndarray, colour: int) -> bytes:
    """16 bits a channel; values: (H, W, channels); colour: PNG's number of their meaning."""
    height, width, _ = values.shape
    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)  # 0: no filter
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*each) for each in chunks)


@pytest.mark.parametrize(("colour", "channels"), [(2, 3), (6, 4), (0, 1)])
def test_a_png_of_16_bits_is_known_to_half_of_its_own_levels(
    colour: int, channels: int, tmp_path: Path
) -> None:
    """RGB, RGBA (opacity is no light and left out) and grey: not one bit is lost."""
    values = np.random.default_rng(53).integers(0, 65536, (HEIGHT, WIDTH, channels))
    values[0, 0], values[0, 1] = 0, 65535
    (tmp_path / "deep.png").write_bytes(deep_png(values, colour))
    image = read_image(tmp_path / "deep.png")
    expected = np.broadcast_to((values[..., :3] + 0.5) / 65535, (HEIGHT, WIDTH, 3))
    assert (image.radiance == expected).all()
    assert image.clipped and np.all(image.rounding == 0.5 / 65535)


def test_grey_with_opacity_in_16_bits_is_refused(tmp_path: Path) -> None:
    """Pillow would give the high bytes alone."""
    (tmp_path / "deep.png").write_bytes(deep_png(np.full((4, 4, 2), 40000), 4))
    with pytest.raises(ImageError, match=r"deep\.png: LA;16B pixels, not 8 or 16 bits"):
        read_image(tmp_path / "deep.png")


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P"])
def test_a_bmp_is_read_as_a_png_of_the_same_pixels(mode: str, tmp_path: Path) -> None:
    """24 and 32 bits, grey and 256 colours."""
    values = np.random.default_rng(54).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    same = PillowImage.fromarray(values).convert(mode)
    for suffix in ("bmp", "png"):
        same.save(tmp_path / f"a.{suffix}")
    bmp, png = read_image(tmp_path / "a.bmp"), read_image(tmp_path / "a.png")
    assert (bmp.radiance == png.radiance).all()
    assert bmp.clipped and np.all(bmp.rounding == 1 / 510)


def test_a_bmp_of_five_bits_a_channel_is_refused(tmp_path: Path) -> None:
    header = struct.pack("<IiiHHIIiiII", 40, 2, 2, 1, 16, 0, 8, 0, 0, 0, 0)
    (tmp_path / "a.bmp").write_bytes(b"BM" + struct.pack("<IHHI", 62, 0, 0, 54) + header + bytes(8))
    with pytest.raises(ImageError, match=r"a\.bmp: BGR;15 pixels, not 8 or 16 bits"):
        read_image(tmp_path / "a.bmp")


@pytest.mark.parametrize("packed", [False, True])
def test_an_hdr_is_known_to_half_of_its_last_bit_over_its_whole_range(
    packed: bool, tmp_path: Path
) -> None:
    """A byte v and exponent e stand for (v + 1/2) 2^(e - 136); e = 0 is black. Noise, which does
    not pack, and a plain field, which does."""
    draw = np.random.default_rng(55)
    radiance = 10 ** draw.uniform(-30, 30, (20, 300, 1)) * draw.random((20, 300, 3))
    radiance[3:9, 10:290] = (0.2, 0.7, 5.0)
    radiance[12] = 0
    (tmp_path / "a.hdr").write_bytes(hdr(radiance, packed))
    image = read_image(tmp_path / "a.hdr")
    error = np.abs(image.radiance - radiance)
    assert (error <= np.expand_dims(image.rounding, -1) * (1 + 1e-12)).all()
    assert (image.radiance[12] == 0).all() and not image.clipped
    largest = radiance.max(axis=-1)
    assert (image.rounding <= largest / 256).all() and (image.rounding >= largest / 513).all()
    # 5 = 0.625 2^3: e = 131, and bytes of 1/32: 6.4, 22.4 and 160, truncated
    assert (image.radiance[5, 20] == np.array([6.5, 22.5, 160.5]) / 32).all()


def test_the_exposure_of_an_hdr_is_taken_out(tmp_path: Path) -> None:
    """Pixels are radiance times each exposure that the header names."""
    radiance = np.random.default_rng(56).random((4, 9, 3))
    (tmp_path / "plain.hdr").write_bytes(hdr(radiance))
    exposures = b"EXPOSURE=2\nEXPOSURE= 0.25\n"
    (tmp_path / "exposed.hdr").write_bytes(hdr(radiance, header=exposures))
    plain, exposed = (read_image(tmp_path / f"{name}.hdr") for name in ("plain", "exposed"))
    assert (exposed.radiance == 2 * plain.radiance).all()
    assert np.all(exposed.rounding == 2 * plain.rounding)


SMALL_HDR = hdr(np.ones((2, 9, 3)))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (SMALL_HDR.replace(b"-Y 2 +X 9", b"+X 9 -Y 2"), "starts at its top left"),
        (SMALL_HDR.replace(b"rgbe", b"xyze"), "not a Radiance picture of RGB"),
        (SMALL_HDR.replace(b"+X 9", b"+X 7"), "last pixel|longer|cut short"),
        (SMALL_HDR.replace(b"-Y 2", b"-Y 16385"), "16385 pixels"),
        (SMALL_HDR.replace(b"-Y 2", b"-Y 16384"), "cannot be read"),
        (hdr(np.ones((2, 9, 3)), header=b"EXPOSURE=0\n"), "an exposure of 0"),
        (hdr(np.ones((2, 9, 3)), header=b"EXPOSURE=nan\n"), "an exposure of nan"),
        (hdr(np.ones((2, 9, 3)), header=b"EXPOSURE=much\n"), "cannot be read"),
        (SMALL_HDR + b"\0", "1 bytes after its last pixel"),
        (hdr(np.ones((1, 2, 3)), False)[:-8] + bytes((1, 1, 1, 2)) * 2, "given up in 1991"),
    ],
)
def test_an_hdr_whose_header_lies_is_refused(content: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.hdr").write_bytes(content)
    with pytest.raises(ImageError, match=rf"a\.hdr: .*({reason})"):
        read_image(tmp_path / "a.hdr")


def test_an_enormous_picture_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    """A PNG of 60000 x 60000 pixels in 100 bytes."""
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
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
