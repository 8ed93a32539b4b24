"""A student's picture as numbers: linear values, what is clipped, where the background shows."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from penumbra.compare.exact.receivers import BACKGROUND, camera_hits
from penumbra.compare.measure.image import MAX_SIDE, UNREADABLE, ImageError, read_image, read_levels
from penumbra.compare.scene import Scene
from penumbra.language import N_, _, numbers, say

LUMA = np.array([0.299, 0.587, 0.114])
"""JPEG's brightness of red, green and blue"""
ROUNDED, EITHER = ", rounded", ", rounded or not"
"""After the name of a curve: rounded, not truncated; the background does not tell (of "rounded":
whether it was truncated after times 256)"""
MOST_PIXELS = 1 << 23
"""Of a picture: more would take minutes and gigabytes, and say no more"""
EIGHT_BITS = (".png", ".jpg", ".jpeg", ".bmp", ".ppm")
Curve = Callable[[np.ndarray], np.ndarray]


def _srgb(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def _srgb_back(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


GAMMAS: dict[str, tuple[Curve, Curve]] = {
    "gamma 2.2": (lambda v: v ** (1 / 2.2), lambda e: e**2.2),
    "sRGB": (_srgb, _srgb_back),
    "square root": (np.sqrt, np.square),
    "gamma twice": (lambda v: v ** (1 / 2.2**2), lambda e: e ** (2.2**2)),
}
NAMES = N_("gamma 2.2"), N_("sRGB"), N_("square root"), N_("gamma twice")
"""Of GAMMAS, as they are said"""
"""Name of a curve between linear values and what is stored, in [0, 1]: there, and back."""


@dataclass(frozen=True)
class Picture:
    """One picture of a student's."""

    name: str
    values: np.ndarray
    """(H, W, 3) float64 [W m^-2 sr^-1], linear, row 0 on top as in the file (a picture upside
    down is not turned); 1.0 where it is clipped at the top"""
    clipped: np.ndarray
    """(H, W, 3) bool: at or above the top"""
    background: np.ndarray
    """(H, W) bool: shows the background"""
    nb_light_samples: int
    samples_per_pixel: int
    law: str
    """how values became numbers: "truncated", "rounded", "truncated 256", a name of GAMMAS, or
    "float" """
    quantisation_variance: float
    """what the file's steps (and JPEG) add to a pixel's variance [value^2]"""
    jpeg: str
    """"fine", "coarse" (low quality, or halved colours), or "" """
    facts: tuple[tuple[str, str], ...] = ()
    """(code, text for the student): "background", "transfer" """


def read_picture(
    file: str | Path, scene: Scene, nb_light_samples: int, samples_per_pixel: int
) -> Picture:
    """Read .png, .jpg, .bmp, .ppm (8 bits, PNG also 16), .exr, .pfm, .hdr, or .npy of (H, W, 3)
    floats or bytes. Raises ImageError.

    The background, of which the scene's radiance is known, tells how the file's numbers stand for
    values; without it they are taken as the lab writes them, times 255 and truncated.
    """
    path = Path(file)
    levels, top, jpeg, step = _numbers(path)
    height, width = levels.shape[:2]
    if height * width > MOST_PIXELS:
        raise ImageError(
            say(
                "{path}: {width} x {height} pixels, more than {most_pixels}: render it smaller, "
                "{own_width} x {own_height} say",
                path=path,
                width=width,
                height=height,
                most_pixels=MOST_PIXELS,
                own_width=scene.width,
                own_height=scene.height,
            )
        )
    colour, law, facts = _background(levels, top, jpeg, scene)
    tolerance = {"": 0.0, "fine": 3.0, "coarse": 12.0}[jpeg] if top else 0.1
    mixed = bool(jpeg) or samples_per_pixel > 1
    shows = np.zeros(levels.shape[:2], dtype=bool)
    if colour is not None:
        shows = _flat(levels, colour, tolerance, mixed, jpeg == "coarse")
    if top == 0:
        # a float picture is looked at as it would be seen, so that one law holds for all
        values = np.minimum(levels / 255, 1)
        clipped = values >= 1
        variance = step**2 / 12
        law = "float"
    else:
        margin = {"": 0, "fine": 1, "coarse": 3}[jpeg]
        values, clipped = _decode(levels, law, top), levels >= top - margin
        values[clipped] = 1.0
        values[levels <= margin] = 0.0
        slope = (_decode(levels + 0.5, law, top) - _decode(levels - 0.5, law, top))[~clipped]
        steepness = float(np.mean(slope**2)) if slope.size else 1 / top**2
        variance = (1 / 12 + {"": 0.0, "fine": 0.35, "coarse": 4.0}[jpeg]) * steepness
    return Picture(
        str(path),
        values,
        clipped,
        shows,
        nb_light_samples,
        samples_per_pixel,
        law.partition(",")[0],
        variance,
        jpeg,
        facts,
    )


COUNT = r"[ _=-]?(\d{1,6})(?![0-9a-z]|\.\d)"
LIGHT_SAMPLES = re.compile(rf"(?:(?<![a-z])n|(?:nb)?_?light_?samples){COUNT}")
PIXEL_SAMPLES = re.compile(
    rf"(?:(?<![a-z])aa|(?<![a-z])spp|(?:nb)?_?pixel_?samples|samples_?per_?pixel){COUNT}"
    rf"|(?<![a-z])n[ _=-]?\d+[ _-]?m{COUNT}"
)
PER_PIXEL = re.compile(r"(?<![0-9a-z.])(\d{1,6})_?spp(?![0-9a-z])")


def counts_in_name(file: str | Path) -> tuple[int | None, int | None]:
    """(light samples, samples per pixel) that a file's name states, as n016_aa01.png does or
    tp3_N64.png; None where it does not, or contradicts itself."""
    stem = re.sub(r"\.[A-Za-z]\w*$", "", Path(file).name).lower()
    glued = re.search(r"(?<![a-z])n(\d{1,6})m(\d{1,6})(?![0-9a-z])", stem)
    if glued:
        return int(glued[1]) or None, int(glued[2]) or None
    light = _stated(LIGHT_SAMPLES.findall(stem))
    pixel = ["".join(groups) for groups in PIXEL_SAMPLES.findall(stem)]
    if light is not None:  # "64spp" alone might mean either
        pixel += PER_PIXEL.findall(stem)
    return light, _stated(pixel)


def _stated(found: list[str]) -> int | None:
    counts = {int(text) for text in found}
    return counts.pop() or None if len(counts) == 1 else None


def _numbers(path: Path) -> tuple[np.ndarray, int, str, float]:
    """(H, W, 3) numbers, the greatest that they can be (0: floats, here times 255), JPEG's kind,
    and the step between floats [value]."""
    suffix = path.suffix.lower()
    if suffix in EIGHT_BITS:
        return *read_levels(path), 0.0
    if suffix == ".npy":
        values = _read_npy(path)
        if values.dtype == np.uint8:
            return values.astype(np.float64), 255, "", 0.0
        return values.astype(np.float64) * 255, 0, "", 0.0
    image = read_image(path)
    return image.radiance * 255, 0, "", 2 * float(np.sqrt(np.mean(np.square(image.rounding))))


def _read_npy(path: Path) -> np.ndarray:
    if not path.is_file():
        raise ImageError(say("{path}: no such file", path=path))
    try:  # mapped, so that a header's claim costs no memory
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
        shape, kind = stored.shape, stored.dtype
        if len(shape) != 3 or shape[2] != 3 or not (kind == np.uint8 or kind.kind == "f"):
            raise ImageError(
                say(
                    "{path}: {kind} of shape {shape}, not (H, W, 3) floats or bytes",
                    path=path,
                    kind=kind,
                    shape=shape,
                )
            )
        if not all(1 <= side <= MAX_SIDE for side in shape[:2]):
            raise ImageError(
                say(
                    "{path}: {width} x {height} pixels, not 1 to {max_side} a side",
                    path=path,
                    width=shape[1],
                    height=shape[0],
                    max_side=MAX_SIDE,
                )
            )
        values = np.array(stored)
    except ImageError:
        raise
    except (*UNREADABLE, EOFError, AttributeError) as error:
        raise ImageError(say("{path}: cannot be read: {error}", path=path, error=error)) from error
    bad = np.count_nonzero(~np.isfinite(values).all(axis=-1))
    if bad:
        raise ImageError(say("{path}: {bad} pixels are NaN or infinite", path=path, bad=bad))
    return values


def _encoded(value: np.ndarray, top: int) -> list[tuple[str, np.ndarray]]:
    """The levels that value, in [0, 1], may have in a file, by law; the likeliest law first."""
    linear = [
        ("truncated", np.floor(value * top)),
        ("rounded", np.floor(value * top + 0.5)),
        ("truncated 256", np.minimum(np.floor(value * (top + 1)), top)),
    ]
    curved = [(name, curve(value)) for name, (curve, _) in GAMMAS.items()]
    curved.append(("gamma twice", _srgb(_srgb(value))))
    for name, stored in curved:
        linear += [(name, np.floor(stored * top)), (name + ROUNDED, np.floor(stored * top + 0.5))]
        linear.append((name + ROUNDED, np.minimum(np.floor(stored * (top + 1)), top)))
    return linear


def _decode(levels: np.ndarray, law: str, top: int) -> np.ndarray:
    """The middle of the values that give each level."""
    if law == "rounded" + EITHER:
        return (levels + 0.25) / (top + 0.5)
    if law == "rounded":
        return levels / top
    if law == "truncated 256":
        return (levels + 0.5) / (top + 1)
    curve, _, rounding = law.partition(",")
    stored = np.clip((levels + {"": 0.5, ROUNDED[1:]: 0.0}.get(rounding, 0.25)) / top, 0, None)
    return GAMMAS[curve][1](stored) if curve in GAMMAS else stored


def _background(
    levels: np.ndarray, top: int, jpeg: str, scene: Scene
) -> tuple[np.ndarray | None, str, tuple[tuple[str, str], ...]]:
    """The background's (3,) levels (None: none is seen), the law that they tell, facts."""
    height, width = levels.shape[:2]
    stride = max(1, height // 50)
    row, column = (a.ravel() for a in np.mgrid[0:height:stride, 0:width:stride])
    seen = camera_hits(scene, column + 0.5, row + 0.5, width, height).object_id
    sky = np.zeros((height, width), dtype=bool)
    sky[row, column] = seen == BACKGROUND
    if not sky.any():
        return None, "truncated", ()
    radiance = np.asarray(scene.background_radiance)
    value = np.clip(radiance, 0, 1) if top else radiance
    laws = _encoded(value, top) if top else [("float", radiance * 255)]
    near = {"": 0.0, "fine": 1.0, "coarse": 2.0}[jpeg] if top == 255 else max(top / 512, 0.3)
    colours, counts = _common(levels)
    fits = [
        (float(np.abs(colour - level).max()), -count, i, colour)
        for colour, count in zip(colours, counts, strict=True)
        if count > 0.01 * width * height
        for i, (_, level) in enumerate(laws)
        if np.abs(colour - level).max() <= near
    ]
    if fits:
        best = min(fits, key=lambda fit: fit[1:3] if not jpeg else fit[:3])
        law = laws[best[2]][0]
        facts = ()
        curve = law.partition(",")[0]
        if curve in GAMMAS:
            said = say(
                "your picture went through a curve ({curve}); the lab saves linear values",
                curve=_(curve),
            )
            both = {
                name for name, level in laws
                if name.startswith(curve) and np.abs(best[3] - level).max() <= near
            }  # fmt: skip
            return best[3], law if len(both) == 1 else curve + EITHER, (("transfer", said),)
        if law == "rounded" and any(
            name == "truncated 256" and np.abs(best[3] - level).max() <= near
            for name, level in laws
        ):
            law += EITHER
        return best[3], law, facts
    colours, counts = _common(levels[sky])
    colour = colours[0]
    share = np.mean(np.abs(levels[sky] - colour).max(axis=-1) <= max(near, 0.3))
    if share < 0.4:
        said = _("your picture shows no background where the scene has it")
        return None, "truncated", (("background", said),)
    mine = numbers(colour, 255 if top < 256 else top, ".2f")
    want = numbers(radiance, 1, "g")
    said = say(
        "your picture's background is ({mine}), the scene's is ({want})", mine=mine, want=want
    )
    return colour, "truncated", (("background", said),)


def _common(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The 16 most common colours, the first most so, and how many pixels have them. Floats are
    told apart to a thousandth of a level of 8 bits."""
    scale = 1 if float(levels.max(initial=0)) > 0 and (levels == np.rint(levels)).all() else 1000
    whole = np.clip(np.rint(levels.reshape(-1, 3) * scale), 0, (1 << 20) - 1).astype(np.int64)
    codes = (whole[:, 0] << 40) + (whole[:, 1] << 20) + whole[:, 2]
    codes, counts = np.unique(codes, return_counts=True)
    first = np.argsort(-counts, kind="stable")[:16]
    codes = codes[first]
    mask = (1 << 20) - 1
    colours = np.stack([codes >> 40, codes >> 20 & mask, codes & mask], axis=-1) / scale
    return colours, counts[first]


def _flat(
    levels: np.ndarray, colour: np.ndarray, tolerance: float, mixed: bool, blurred: bool
) -> np.ndarray:
    """Where the background is, given its colour: wide areas of it, so that no shade of a surface
    that happens to be the same is taken for it.

    mixed: the outline's pixels are mixtures, and the background's if more than half of them is.
    blurred: colours are known to two pixels, brightness to one.
    """
    distance = np.abs(levels - colour).max(axis=-1)
    near = distance <= tolerance
    if mixed:
        # the channels that an object darkens: what is brighter may be far brighter than the top
        darker = (colour - levels) @ LUMA if blurred else (colour - levels).max(axis=-1)
        most = ndimage.maximum_filter(darker, 5)
        plain = distance < 0.5 * ndimage.maximum_filter(distance, 5)
        near |= np.where(most > 0.5 * colour.max(), darker < 0.5 * most, plain)
    square = np.ones((3, 3), dtype=bool)
    core = ndimage.binary_opening(distance <= tolerance, square, iterations=2)
    core |= _touching_border(distance <= tolerance, core)
    return ndimage.binary_dilation(core, square, iterations=4, mask=near)


def _touching_border(near: np.ndarray, core: np.ndarray) -> np.ndarray:
    """The opening takes the picture's border away from areas that reach it: given back."""
    grown = ndimage.binary_dilation(core, np.ones((3, 3), dtype=bool), iterations=2, mask=near)
    border = np.ones_like(core)
    border[2:-2, 2:-2] = False
    return grown & border
