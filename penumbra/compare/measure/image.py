"""Rendered images: reading and writing, with the provenance that their headers carry."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import threading
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image as PillowImage
from PIL.ImageFile import ImageFile as PillowImageFile
from PIL.JpegImagePlugin import JpegImageFile

from penumbra.compare.run.output import PICTURES, write_whole
from penumbra.language import _, say

CHANNELS = ("R", "G", "B")
PIXELS = ("RGB", "RGBA", "L", "P", "CMYK", "YCbCr")
DEEP = {"RGB;16B": "RGB;16L", "RGBA;16B": "RGBA;16L"}
"""Pillow's layouts of 8 bits a channel; of 16, each with the other byte order"""
MAX_SIDE, MAX_TILE_SIDE = 16384, 4096
"""Most pixels in a row or column of an EXR, as in scenes/scene.schema.json, and of its tiles. The
library believes a header: without a limit, 7 kB that claimed a large tile took 7 GB."""
OpenEXR.setMaxImageSize(MAX_SIDE, MAX_SIDE)
OpenEXR.setMaxTileSize(MAX_TILE_SIDE, MAX_TILE_SIDE)
UNREADABLE = (
    *(OSError, RuntimeError, ValueError, TypeError, MemoryError),
    SyntaxError,  # Pillow: a broken picture, then enormous ones
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)
"""What the libraries raise for files that are not what they seem."""


class ImageError(ValueError):
    """An image that cannot be used; the text names the file and the reason."""


@dataclass(frozen=True)
class Image:
    """One linear image."""

    radiance: np.ndarray
    """(H, W, 3) float64 [W m^-2 sr^-1], row 0 on top"""
    variance: np.ndarray | None = None
    """(H, W, 3) float64: variance of each pixel's mean; None where it is not known"""
    attributes: dict[str, str | int | float] = field(default_factory=dict)
    """header attributes: sceneHash, lightSamples, seed, ..."""
    rounding: np.ndarray | float = 0.0
    """(H, W) [W m^-2 sr^-1]: half a step of what the file's pixels can say, where that is much"""
    clipped: bool = False
    """values were cut to [0, 1]"""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)"""
        return self.radiance.shape[0], self.radiance.shape[1]

    @property
    def is_eight_bit(self) -> bool:
        """It was read from a picture of 8 bits a channel, what a student's program saves."""
        return self.clipped and bool(np.max(self.rounding) >= 0.5 / 255)


def read_image(file: str | Path) -> Image:
    """Read .exr, .pfm (float, little or big endian), .hdr (Radiance), .png (8 or 16 bits a
    channel), .jpg or .bmp (8 bits a channel, or a palette).

    An 8-bit image is taken as the lab saves it, clamped to [0, 1], times 255 and truncated:
    v stands for (v + 1/2) / 255, so it is known to +-1/510 and not at all above 1. So are 16
    bits, to +-1/131070, and the bytes of .hdr, to half of what one counts: 1/256 to 1/512 of
    the largest channel.
    Raises ImageError for a file that is missing, cut short, of another kind, of several images,
    without R, G, B, or with NaN, infinite or (variance) negative values.
    """
    path = Path(file)
    if not path.is_file():
        raise ImageError(say("{path}: no such file", path=path))
    suffix = path.suffix.lower()
    try:
        if suffix == ".exr":
            image = _read_exr(path)
        elif suffix == ".pfm":
            image = Image(_read_pfm(path))
        elif suffix == ".hdr":
            image = _read_hdr(path)
        elif suffix in (*PICTURES, ".bmp"):
            values, levels, _ = _read_levels(path)
            image = _from_levels(values, levels)
        else:
            raise ImageError(
                say("{path}: not an .exr, .pfm, .hdr, .png, .jpg or .bmp file", path=path)
            )
    except ImageError:
        raise
    except UNREADABLE as error:
        raise ImageError(say("{path}: cannot be read: {error}", path=path, error=error)) from error
    _check(path, image)
    return image


def write_exr(file: str | Path, image: Image) -> None:
    """Write radiance, variance (if any) and attributes as 32-bit float scanlines, ZIP.

    The file appears under its name only when it is whole. Raises ImageError if it cannot
    be written, or holds what could not be read again: NaN, infinity, values beyond float32.
    """
    path = Path(file)
    channels = {c: _plane(image.radiance, i) for i, c in enumerate(CHANNELS)}
    if image.variance is not None:
        channels |= {f"variance.{c}": _plane(image.variance, i) for i, c in enumerate(CHANNELS)}
    if not all(np.isfinite(plane).all() for plane in channels.values()):
        raise ImageError(
            say("{path}: not written: values are NaN, infinite or beyond float32", path=path)
        )
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        **image.attributes,
    }
    # To memory first: of a file the library does not notice that its last bytes, which for a small
    # image are all of them, found the disk full.
    stream = io.BytesIO()
    try:
        OpenEXR.File(header, channels).write(stream)
        write_whole(path, lambda part: part.write_bytes(stream.getbuffer()))
    except OSError as error:
        raise _unwritten(error) from error
    except RuntimeError as error:
        raise ImageError(
            say("{path}: cannot be written: {error}", path=path, error=error)
        ) from error


def _unwritten(error: OSError) -> ImageError:
    return ImageError(
        say(
            "{filename}: cannot be written: {strerror}",
            filename=error.filename,
            strerror=error.strerror,
        )
    )


def write_display(file: str | Path, radiance: np.ndarray) -> None:
    """Save as the lab does: clamp to [0, 1], times 255, truncated, no gamma.

    radiance: (H, W, 3). The suffix chooses PNG or JPG (quality 100, colour at full resolution); no
    suffix is PNG.
    Raises ImageError if it cannot be written, or holds NaN or infinity.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix and suffix not in PICTURES:
        raise ImageError(say("{path}: a picture's name ends in .png or .jpg", path=path))
    if not np.isfinite(radiance).all():
        raise ImageError(say("{path}: not written: values are NaN or infinite", path=path))
    picture = PillowImage.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8))
    kind = "JPEG" if suffix in (".jpg", ".jpeg") else "PNG"
    try:
        write_whole(path, lambda part: picture.save(part, kind, quality=100, subsampling=0))
    except OSError as error:
        raise _unwritten(error) from error


def _plane(values: np.ndarray, channel: int) -> np.ndarray:
    with np.errstate(over="ignore"):  # beyond float32 becomes infinite, and is refused
        return np.ascontiguousarray(values[..., channel], dtype=np.float32)


def _read_exr(path: Path) -> Image:
    with _silent():
        try:
            with OpenEXR.File(str(path), header_only=True) as exr:
                images = len(exr.parts)
        except RuntimeError as error:  # which says no more than that it failed
            reason = say(
                "no EXR header, or over {max_side} pixels a side, {max_tile_side} of a tile",
                max_side=MAX_SIDE,
                max_tile_side=MAX_TILE_SIDE,
            )
            raise ImageError(
                say("{path}: cannot be read: {reason}", path=path, reason=reason)
            ) from error
        if images != 1:
            raise ImageError(
                say("{path}: holds {images} images, not one", path=path, images=images)
            )
        with OpenEXR.File(str(path), separate_channels=True) as exr:
            if not exr.parts:  # the library drops what it cannot decode
                raise ImageError(
                    say("{path}: cannot be read: its pixels are damaged or cut short", path=path)
                )
            header = dict(exr.header())  # the file empties its own on closing
            channels = {name: channel.pixels for name, channel in exr.channels().items()}

    def stack(prefix: str) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # a signalling NaN, which is refused in time
            return np.stack([channels[prefix + c] for c in CHANNELS], axis=-1).astype(np.float64)

    has_variance = any(name.startswith("variance.") for name in channels)
    wanted = [p + c for p in ("", "variance.")[: 1 + has_variance] for c in CHANNELS]
    missing = [name for name in wanted if name not in channels]
    if missing:
        raise ImageError(
            say("{path}: has no channel {missing}", path=path, missing=", ".join(missing))
        )
    variance = stack("variance.") if has_variance else None
    attributes = {k: v for k, v in header.items() if isinstance(v, str | int | float)}
    return Image(stack(""), variance, attributes)


_SILENCE = threading.Lock()


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """OpenEXR prints its troubles itself, through Python and past it, some to standard output: not
    meanwhile. One thread at a time, or the second takes the first one's silence for the output to
    go back to."""
    with _SILENCE, _no_output():
        yield


@contextlib.contextmanager
def _no_output() -> Iterator[None]:
    null = os.open(os.devnull, os.O_WRONLY)
    kept = {}
    try:
        for descriptor in (1, 2):
            with contextlib.suppress(OSError):  # it is closed
                kept[descriptor] = os.dup(descriptor)
                os.dup2(null, descriptor)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        for descriptor, copy in kept.items():
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(null)


def read_levels(file: str | Path) -> tuple[np.ndarray, int, str]:
    """The numbers in a .png, .jpg, .bmp or .ppm file: (H, W, 3) float64, the greatest that they
    can be (255 or 65535), and of a JPEG whether it is "fine" or "coarse" (low quality, or its
    colours at half the resolution), else "". Raises ImageError.
    """
    path = Path(file)
    if not path.is_file():
        raise ImageError(say("{path}: no such file", path=path))
    try:
        return _read_levels(path)
    except ImageError:
        raise
    except UNREADABLE as error:
        raise ImageError(say("{path}: cannot be read: {error}", path=path, error=error)) from error


def _read_levels(path: Path) -> tuple[np.ndarray, int, str]:
    picture = _open_picture(path)
    with picture:
        raw = _raw_mode(picture)
        if raw == "I;16B":
            grey = np.asarray(picture, dtype=np.float64)
            return np.stack([grey] * 3, axis=-1), 65535, ""
        if picture.mode not in PIXELS or ";15" in raw or (raw not in DEEP and ";16" in raw):
            raise ImageError(
                say(
                    "{path}: {kind} pixels, not 8 or 16 bits a channel",
                    path=path,
                    kind=raw or picture.mode,
                )
            )
        jpeg = _jpeg_kind(picture)
        values = np.asarray(picture.convert("RGB"), dtype=np.float64)
    if raw not in DEEP:
        return values, 255, jpeg
    # Pillow gives the high bytes alone. Of the other byte order it takes the low ones for them.
    with _open_picture(path) as picture:
        picture.tile = [tile._replace(args=DEEP[raw]) for tile in picture.tile]
        low = np.asarray(picture.convert("RGB"), dtype=np.float64)
    return 256 * values + low, 65535, ""


def _jpeg_kind(picture: PillowImageFile) -> str:
    if not isinstance(picture, JpegImageFile):
        return ""
    steps = np.mean(picture.quantization[min(picture.quantization)])
    halved = picture.layer[0][1:3] != (1, 1)
    return "coarse" if steps > 6 or halved else "fine"


def _open_picture(path: Path) -> PillowImageFile:
    with warnings.catch_warnings():
        warnings.simplefilter("error", PillowImage.DecompressionBombWarning)
        # Of these kinds only: Pillow knows forty, of which one starts another program.
        return PillowImage.open(path, formats=("PNG", "JPEG", "BMP", "PPM"))


def _raw_mode(picture: PillowImageFile) -> str:
    """What Pillow calls the layout of the file's pixels; "" if it has none."""
    arguments = picture.tile[0].args if picture.tile else ""
    return str(arguments[0] if isinstance(arguments, tuple) else arguments)


def _from_levels(values: np.ndarray, levels: int) -> Image:
    """values: (H, W, 3), 0 to levels"""
    half = np.full(values.shape[:2], 0.5 / levels)
    return Image((values + 0.5) / levels, rounding=half, clipped=True)


def _read_hdr(path: Path) -> Image:
    """Radiance's pixels: three bytes and the power of two that they share. Each byte stands for
    its middle, as Radiance itself reads it. https://radsite.lbl.gov/radiance/refer/filefmts.pdf"""
    header, _, rest = path.read_bytes().partition(b"\n\n")
    size, _, data = rest.partition(b"\n")
    lines = [line.strip() for line in header.split(b"\n")]
    sides = re.fullmatch(rb"-Y (\d{1,5}) \+X (\d{1,5})", size)
    if lines[0][:2] != b"#?" or b"FORMAT=32-bit_rle_rgbe" not in lines or not sides:
        raise ImageError(
            say("{path}: not a Radiance picture of RGB that starts at its top left", path=path)
        )
    height, width = int(sides[1]), int(sides[2])
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise ImageError(
            say(
                "{path}: {width} x {height} pixels, not 1 to {max_side} a side",
                path=path,
                width=width,
                height=height,
                max_side=MAX_SIDE,
            )
        )
    exposures = [line[9:] for line in lines if line.startswith(b"EXPOSURE=")]
    exposure = math.prod(map(float, exposures))  # already multiplied in
    if not 1e-30 < exposure < 1e30:
        raise ImageError(say("{path}: an exposure of {exposure}", path=path, exposure=exposure))
    rows, start = [], 0
    for _ in range(height):
        row, start = _hdr_row(data, start, width)
        rows.append(row)
    if start != len(data):
        raise ImageError(
            say("{path}: {count} bytes after its last pixel", path=path, count=len(data) - start)
        )
    pixels = np.stack(rows)
    step = np.where(pixels[..., 3] > 0, np.ldexp(1 / exposure, pixels[..., 3].astype(int) - 136), 0)
    return Image((pixels[..., :3] + 0.5) * step[..., None], rounding=step / 2)


def _hdr_row(data: bytes, start: int, width: int) -> tuple[np.ndarray, int]:
    """(width, 4) uint8, and where the next row starts. Raises ValueError."""
    if not (width >= 8 and data[start : start + 4] == bytes((2, 2, *divmod(width, 256)))):
        end = start + 4 * width
        if end > len(data):
            raise ValueError(_("its pixels are damaged or cut short"))
        pixels = np.frombuffer(data[start:end], np.uint8).reshape(width, 4)
        if (pixels[:, :3] == 1).all(axis=1).any():  # no pixel: its largest byte is above 127
            raise ValueError(_("run lengths of the kind that was given up in 1991"))
        return pixels, end
    start += 4
    planes = bytearray()
    for plane in range(1, 5):
        while len(planes) < plane * width:
            count = data[start] if start < len(data) else 0
            if count == 0:
                raise ValueError(_("its pixels are damaged or cut short"))
            if count > 128:
                planes += data[start + 1 : start + 2] * (count - 128)
                start += 2
            else:
                planes += data[start + 1 : start + 1 + count]
                start += 1 + count
        if len(planes) > plane * width:
            raise ValueError(_("a row is longer than the picture is wide"))
    return np.frombuffer(planes, np.uint8).reshape(4, width).T, start


def _read_pfm(path: Path) -> np.ndarray:
    with path.open("rb") as stream:
        kind = stream.readline(16).strip()
        size = stream.readline(64).split()
        scale = float(stream.readline(64))
        data = stream.read()
    if kind != b"PF" or len(size) != 2 or scale == 0 or not np.isfinite(scale):
        raise ImageError(say("{path}: not a colour PFM file", path=path))
    width, height = int(size[0]), int(size[1])
    if width < 1 or height < 1 or len(data) != 12 * width * height:
        raise ImageError(
            say(
                "{path}: {count} bytes of pixels, not {width} x {height} x 12",
                path=path,
                count=len(data),
                width=width,
                height=height,
            )
        )
    values = np.frombuffer(data, dtype="<f4" if scale < 0 else ">f4")
    with np.errstate(invalid="ignore"):  # a signalling NaN, which is refused in time
        return values.reshape(height, width, 3)[::-1].astype(np.float64)


def _check(path: Path, image: Image) -> None:
    bad = ~np.isfinite(image.radiance).all(axis=-1)
    if bad.any():
        y, x = np.argwhere(bad)[0]
        raise ImageError(
            say(
                "{path}: {count} pixels are NaN or infinite, the first at ({x}, {y})",
                path=path,
                count=int(bad.sum()),
                x=x,
                y=y,
            )
        )
    if image.variance is not None and not (
        np.isfinite(image.variance).all() and (image.variance >= 0).all()
    ):
        raise ImageError(say("{path}: a variance is NaN, infinite or negative", path=path))
