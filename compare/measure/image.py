"""Rendered images: reading and writing, with the provenance that their headers carry."""

from __future__ import annotations

import contextlib
import io
import os
import threading
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image as PillowImage

from compare.run.output import PICTURES, write_whole

CHANNELS = ("R", "G", "B")
EIGHT_BIT = (".png", ".jpg", ".jpeg")
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

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)"""
        return self.radiance.shape[0], self.radiance.shape[1]


def read_image(file: str | Path) -> Image:
    """Read .exr, .pfm (float, little or big endian), or an 8-bit .png or .jpg.

    An 8-bit image is taken as the lab saves it, clamped to [0, 1], times 255 and truncated:
    v stands for (v + 1/2) / 255, so it is known to +-1/510 and not at all above 1.
    Raises ImageError for a file that is missing, cut short, of another kind, of several images,
    without R, G, B, or with NaN, infinite or (variance) negative values.
    """
    path = Path(file)
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    suffix = path.suffix.lower()
    try:
        if suffix == ".exr":
            image = _read_exr(path)
        elif suffix == ".pfm":
            image = Image(_read_pfm(path))
        elif suffix in EIGHT_BIT:
            image = Image((_read_eight_bit(path) + 0.5) / 255)
        else:
            raise ImageError(f"{path}: not an .exr, .pfm, .png or .jpg file")
    except ImageError:
        raise
    except UNREADABLE as error:
        raise ImageError(f"{path}: cannot be read: {error}") from error
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
        raise ImageError(f"{path}: not written: values are NaN, infinite or beyond float32")
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
        raise ImageError(f"{error.filename}: cannot be written: {error.strerror}") from error
    except RuntimeError as error:
        raise ImageError(f"{path}: cannot be written: {error}") from error


def write_display(file: str | Path, radiance: np.ndarray) -> None:
    """Save as the lab does: clamp to [0, 1], times 255, truncated, no gamma.

    radiance: (H, W, 3). The suffix chooses PNG or JPG (quality 100, colour at full resolution); no
    suffix is PNG.
    Raises ImageError if it cannot be written, or holds NaN or infinity.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix and suffix not in PICTURES:
        raise ImageError(f"{path}: a picture's name ends in .png or .jpg")
    if not np.isfinite(radiance).all():
        raise ImageError(f"{path}: not written: values are NaN or infinite")
    picture = PillowImage.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8))
    kind = "JPEG" if suffix in (".jpg", ".jpeg") else "PNG"
    try:
        write_whole(path, lambda part: picture.save(part, kind, quality=100, subsampling=0))
    except OSError as error:
        raise ImageError(f"{error.filename}: cannot be written: {error.strerror}") from error


def _plane(values: np.ndarray, channel: int) -> np.ndarray:
    with np.errstate(over="ignore"):  # beyond float32 becomes infinite, and is refused
        return np.ascontiguousarray(values[..., channel], dtype=np.float32)


def _read_exr(path: Path) -> Image:
    with _silent():
        try:
            with OpenEXR.File(str(path), header_only=True) as exr:
                images = len(exr.parts)
        except RuntimeError as error:  # which says no more than that it failed
            reason = f"no EXR header, or over {MAX_SIDE} pixels a side, {MAX_TILE_SIDE} of a tile"
            raise ImageError(f"{path}: cannot be read: {reason}") from error
        if images != 1:
            raise ImageError(f"{path}: holds {images} images, not one")
        with OpenEXR.File(str(path), separate_channels=True) as exr:
            if not exr.parts:  # the library drops what it cannot decode
                raise ImageError(f"{path}: cannot be read: its pixels are damaged or cut short")
            header = dict(exr.header())  # the file empties its own on closing
            channels = {name: channel.pixels for name, channel in exr.channels().items()}

    def stack(prefix: str) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # a signalling NaN, which is refused in time
            return np.stack([channels[prefix + c] for c in CHANNELS], axis=-1).astype(np.float64)

    has_variance = any(name.startswith("variance.") for name in channels)
    wanted = [p + c for p in ("", "variance.")[: 1 + has_variance] for c in CHANNELS]
    missing = [name for name in wanted if name not in channels]
    if missing:
        raise ImageError(f"{path}: has no channel {', '.join(missing)}")
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


def _read_eight_bit(path: Path) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("error", PillowImage.DecompressionBombWarning)
        # Of these kinds only: Pillow knows forty, of which one starts another program.
        picture = PillowImage.open(path, formats=("PNG", "JPEG"))
    with picture:
        if picture.mode not in ("RGB", "RGBA", "L", "P", "CMYK", "YCbCr"):
            raise ImageError(f"{path}: {picture.mode} pixels, not 8 bits a channel")
        return np.asarray(picture.convert("RGB"), dtype=np.float64)


def _read_pfm(path: Path) -> np.ndarray:
    with path.open("rb") as stream:
        kind = stream.readline(16).strip()
        size = stream.readline(64).split()
        scale = float(stream.readline(64))
        data = stream.read()
    if kind != b"PF" or len(size) != 2 or scale == 0 or not np.isfinite(scale):
        raise ImageError(f"{path}: not a colour PFM file")
    width, height = int(size[0]), int(size[1])
    if width < 1 or height < 1 or len(data) != 12 * width * height:
        raise ImageError(f"{path}: {len(data)} bytes of pixels, not {width} x {height} x 12")
    values = np.frombuffer(data, dtype="<f4" if scale < 0 else ">f4")
    with np.errstate(invalid="ignore"):  # a signalling NaN, which is refused in time
        return values.reshape(height, width, 3)[::-1].astype(np.float64)


def _check(path: Path, image: Image) -> None:
    bad = ~np.isfinite(image.radiance).all(axis=-1)
    if bad.any():
        y, x = np.argwhere(bad)[0]
        raise ImageError(f"{path}: {bad.sum()} pixels are NaN or infinite, the first at ({x}, {y})")
    if image.variance is not None and not (
        np.isfinite(image.variance).all() and (image.variance >= 0).all()
    ):
        raise ImageError(f"{path}: a variance is NaN, infinite or negative")
