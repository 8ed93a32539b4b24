"""Hostile image files: read if they still hold pixels, else refused in one line; never a crash.

Mutations are drawn from a numbered seed: the file of a crash is left in tmp_path.
"""

from __future__ import annotations

import io
import random
import resource
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import PIL.Image
import pytest

from penumbra.compare.measure.image import Image, ImageError, read_image, write_exr
from tests.campaign import rounds
from tests.conftest import ROOT
from tests.test_image import deep_png, hdr

HEIGHT, WIDTH = 37, 29
COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB", "ZSTD")
EXTREMES = (0, 1, -1, 2, 255, 256, 65535, 65536, 1 << 20, 1 << 30, (1 << 31) - 1, -(1 << 31))
HEADER = (
    *(b"dataWindow\0box2i\0", b"displayWindow\0box2i\0", b"channels\0chlist\0", b"type\0string\0"),
    *(b"tiles\0tiledesc\0", b"compression\0compression\0", b"lineOrder\0lineOrder\0"),
)


def exr(
    compression: str = "ZIP",
    dtype: type = np.float32,
    tiled: bool = False,
    channels: tuple[str, ...] = ("R", "G", "B"),
    images: int = 1,
    value: float | None = None,
) -> bytes:
    """Random pixels in [0, 1), or `value` all over."""
    generator = np.random.default_rng(50)
    header = {
        "compression": getattr(OpenEXR, f"{compression}_COMPRESSION"),
        "type": OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage,
    }
    if tiled:
        header["tiles"] = OpenEXR.TileDescription()
    parts = []
    for i in range(images):
        planes = {name: generator.random((HEIGHT, WIDTH)).astype(dtype) for name in channels}
        if value is not None:
            planes = {name: np.full_like(plane, value) for name, plane in planes.items()}
        parts.append(OpenEXR.Part(dict(header), planes, f"part{i}"))
    stream = io.BytesIO()
    OpenEXR.File(parts).write(stream)
    return stream.getvalue()


def with_header(data: bytes, attribute: bytes, offset: int, *values: int) -> bytes:
    """32-bit values in the place of those of a header attribute."""
    start = data.index(attribute) + len(attribute) + 4 + offset
    new = struct.pack(f"<{len(values)}i", *values)
    return data[:start] + new + data[start + len(new) :]


def picture(kind: str, mode: str) -> bytes:
    values = np.random.default_rng(51).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    stream = io.BytesIO()
    PIL.Image.fromarray(values).convert(mode).save(stream, kind)
    return stream.getvalue()


def whole_files() -> list[tuple[str, bytes]]:
    """Of every kind that is read, in every compression: (suffix, contents)."""
    six = ("R", "G", "B", "variance.R", "variance.G", "variance.B")
    files = [("exr", exr(c, tiled=tiled)) for c in COMPRESSIONS for tiled in (False, True)]
    files += [("exr", exr(c, np.float16)) for c in COMPRESSIONS]
    files += [("exr", exr(channels=six)), ("exr", exr(images=2)), ("exr", exr(dtype=np.uint32))]
    files += [("png", picture("PNG", mode)) for mode in ("RGB", "RGBA", "L", "P", "1")]
    files += [("jpg", picture("JPEG", mode)) for mode in ("RGB", "L", "CMYK")]
    files += [("bmp", picture("BMP", mode)) for mode in ("RGB", "RGBA", "L", "P")]
    draw = np.random.default_rng(52)
    deep = [(c, draw.integers(0, 65536, (HEIGHT, WIDTH, n))) for c, n in ((2, 3), (6, 4), (0, 1))]
    files += [("png", deep_png(values, colour)) for colour, values in deep]
    pixels = draw.random((HEIGHT, WIDTH, 3)).astype("<f4")
    files += [("hdr", hdr(pixels, packed)) for packed in (False, True)] * 2
    return files + [("pfm", f"PF\n{WIDTH} {HEIGHT}\n-1.0\n".encode() + pixels.tobytes())] * 3


def damaged(data: bytes, draw: random.Random) -> bytes:
    """After one to eight changes, half of them in the first bytes, where headers are."""
    changed = bytearray(data)
    for _ in range(draw.choice([1, 1, 1, 2, 3, 8])):
        place = draw.randrange(min(len(changed), draw.choice([500, 1 << 30])) or 1)
        kind = draw.choice(["bit", "byte", "integer", "cut", "delete", "insert", "header"])
        if kind == "bit":
            changed[place : place + 1] = bytes(
                b ^ 1 << draw.randrange(8) for b in changed[place:][:1]
            )
        elif kind == "byte":
            changed[place : place + 1] = draw.randbytes(1)
        elif kind == "integer":
            changed[place : place + 4] = struct.pack("<i", draw.choice(EXTREMES))
        elif kind == "cut":
            del changed[draw.choice([place, -1]) :]
        elif kind == "delete":
            del changed[place : place + draw.randrange(1, 20)]
        elif kind == "insert":
            changed[place:place] = draw.randbytes(draw.randrange(1, 9))
        else:
            attribute = draw.choice(HEADER)
            found = changed.find(attribute)
            if found >= 0:
                start = found + len(attribute) + 4 * draw.randrange(6)
                changed[start : start + 4] = struct.pack("<i", draw.choice(EXTREMES))
    return bytes(changed)


def test_damaged_images_are_read_or_refused(tmp_path: Path) -> None:
    """2000 files a round. Of them a part is refused and a part read: were it all of one, the
    damage would be too large or too small to find anything."""
    files = whole_files()
    for number in rounds(share=1 / 6):
        read = 0
        for i in range(2000):
            draw = random.Random(f"{number} {i}")
            suffix, data = draw.choice(files)
            file = tmp_path / f"hostile.{suffix}"
            file.write_bytes(damaged(data, draw))
            try:
                image = read_image(file)
            except ImageError as error:
                assert str(file) in str(error)
                continue
            assert np.isfinite(image.radiance).all() and image.radiance.shape[2] == 3
            read += 1
        assert 60 < read < 1500


SIZE, TILES = b"dataWindow\0box2i\0", b"tiles\0tiledesc\0"
WHOLE, FLAT = exr(), exr(value=0.7)  # random pixels are stored as they are
REFUSED = {
    "empty": b"",
    "cut in the header": WHOLE[:60],
    "cut in the pixels": WHOLE[:-100],
    "a bit flipped in the compressed pixels": FLAT[:-50] + bytes([FLAT[-50] ^ 4]) + FLAT[-49:],
    "another kind of file": picture("PNG", "RGB"),
    "2^31 wide": with_header(WHOLE, SIZE, 8, 2**31 - 1),
    "2^31 wide and high": with_header(WHOLE, SIZE, 8, 2**31 - 1, 2**31 - 1),
    "wider than 2^31": with_header(WHOLE, SIZE, 0, -(2**31), 0, 2**31 - 1),
    "of negative width": with_header(WHOLE, SIZE, 8, -5),
    "the largest size, without its pixels": with_header(WHOLE, SIZE, 8, 16383, 16383),
    "one more than the largest size": with_header(WHOLE, SIZE, 8, 16384),
    "tiles of 2^30 rows": with_header(exr(tiled=True), TILES, 0, 32, 1 << 30),
    "tiles of 2^26 rows": with_header(exr("DWAB", tiled=True), TILES, 0, 32, (1 << 26) + 32),
    "NaN": exr(value=float("nan")),
    "infinity": exr(value=float("inf")),
    "a signalling NaN": exr("NO", np.float16, value=1).replace(b"\0\x3c", b"\1\x7c"),
    "no channels of ours": exr(channels=("X", "Y", "Z")),
    "no blue": exr(channels=("R", "G")),
    "two images": exr(images=2),
}


COMPARE_EACH = """
import sys
from penumbra.__main__ import main
for file in sys.argv[2:]:
    print(main(["compare", file, "exact", "--scene", sys.argv[1]]))
"""


def test_compare_refuses_hostile_exr_files_in_one_line_each(scenes: Path, tmp_path: Path) -> None:
    """Exit status 2 and the file's name, in 3 GB of address space (Python with its libraries takes
    1): nothing is allocated because a header says so. Nor do OpenEXR's own messages come through,
    of which it prints some on standard output. One process for all: none may disturb it."""
    files = []
    for case, content in REFUSED.items():
        files.append(tmp_path / f"{case}.exr")
        files[-1].write_bytes(content)
    run = subprocess.run(
        [sys.executable, "-c", COMPARE_EACH, str(scenes / "tp3.json"), *map(str, files)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30)),
    )
    assert run.stdout == "2\n" * len(files), run.stderr
    messages = run.stderr.splitlines()
    for file, message in zip(files, messages, strict=True):
        assert message.startswith(f"penumbra: {file}: "), message
    print(run.stderr)


@pytest.mark.parametrize("kind", ["GIF", "TIFF", "EPS"])
def test_a_picture_of_another_kind_is_refused_whatever_its_name(kind: str, tmp_path: Path) -> None:
    """Pillow would read them; EPS it would give to a program, Ghostscript, to run."""
    (tmp_path / "a.png").write_bytes(picture(kind, "RGB"))
    with pytest.raises(ImageError, match=r"a\.png: cannot be read"):
        read_image(tmp_path / "a.png")


def test_a_refused_image_leaves_standard_output_and_error_open(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """They are turned away while OpenEXR reads."""
    (tmp_path / "cut.exr").write_bytes(WHOLE[:-100])
    write_exr(tmp_path / "whole.exr", Image(np.ones((2, 3, 3))))
    for name in ("cut.exr", "whole.exr", "cut.exr"):
        try:
            read_image(tmp_path / name)
        except ImageError:
            print("refused")
            print("refused", file=sys.stderr)
    assert capfd.readouterr() == ("refused\n" * 2, "refused\n" * 2)
