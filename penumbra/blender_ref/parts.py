"""A reference: independent parts, kept, and their mean with the variance that they show."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from penumbra.blender_ref.process import Cycles, fingerprint
from penumbra.compare.measure.image import Image, ImageError, read_image, write_exr
from penumbra.compare.scene import read_scene


class OptionsError(ValueError):
    """Options that make no reference; the text names them."""


def reference(
    scene_file: str | Path,
    out: str | Path,
    *,
    samples: int,
    parts: int = 8,
    seed: int = 0,
    width: int | None = None,
    height: int | None = None,
    antialias: bool = False,
    progress: bool = True,
) -> None:
    """Render a scene with Cycles: OUT.exr, and OUT.blend to look at.

    samples: light samples per pixel, in all; a multiple of parts. parts: 2 or more images of
    different seeds, kept in OUT.exr.parts/ under names tied to scene, size, samples, seed and
    Blender's version; those already there are not rendered again, so a killed run goes on where
    it was. radiance = mean of the parts, variance = their sample variance / parts.
    width, height: pixels, instead of the scene's own. antialias: uniform positions in the
    pixel instead of its centre. progress: a bar on stderr if that is a terminal.

    Raises OptionsError, SceneError, ImageError, MissingBlender, CyclesError.
    """
    out = Path(out)
    _check_options(out, samples, parts, seed)
    scene = read_scene(scene_file)
    size = f"{width or scene.width}x{height or scene.height}"
    decides = (scene.name, scene.hash, size, samples // parts, seed, antialias, fingerprint())
    key = hashlib.sha256(repr(decides).encode()).hexdigest()[:12]
    folder = out.with_name(out.name + ".parts")
    files = [folder / f"part_{key}_{i:02d}.exr" for i in range(parts)]
    blend = out.with_suffix(".blend")

    missing = [i for i, file in enumerate(files) if not _is_whole(file)]
    if missing or not blend.is_file():
        _remove_others(folder, files)
        bar = tqdm(
            total=parts,
            initial=parts - len(missing),
            desc=f"Cycles {out.name}",
            unit="part",
            disable=None if progress else True,
        )
        with bar, Cycles(scene_file, width, height, antialias) as cycles:
            cycles.save_blend(blend, samples, seed, 0)
            for i in missing:
                write_exr(files[i], cycles.render(samples // parts, seed, i))
                bar.update()
    write_exr(out, _mean([read_image(file) for file in files], seed))


def _check_options(out: Path, samples: int, parts: int, seed: int) -> None:
    if out.suffix != ".exr":
        raise OptionsError(f"{out}: a reference's name ends in .exr")
    if parts < 2:
        raise OptionsError(f"parts = {parts}: it takes 2 or more to show their variance")
    if samples < parts or samples % parts:
        raise OptionsError(f"samples = {samples} is not a multiple of parts = {parts}")
    if seed < 0:
        raise OptionsError(f"seed = {seed}: 0 or more")


def _is_whole(file: Path) -> bool:
    try:
        read_image(file)
    except ImageError:
        return False
    return True


def _remove_others(folder: Path, files: list[Path]) -> None:
    """Parts of another scene, size, seed: they would never be read again."""
    for file in set(folder.glob("part_*")) - set(files):
        file.unlink()


def _mean(parts: list[Image], seed: int) -> Image:
    radiance = np.stack([part.radiance for part in parts])
    first = parts[0].attributes
    seconds = sum(float(part.attributes["renderSeconds"]) for part in parts)
    settings = [json.loads(str(part.attributes["settings"])) for part in parts]
    seeds = [each["cycles.seed"] for each in settings]
    attributes = {
        **first,
        "parts": len(parts),
        "seed": str(seed),
        "settings": json.dumps({**settings[0], "cycles.seed": seeds}),
        "renderSeconds": seconds,
        "lightSamples": int(first["lightSamples"]) * len(parts),
    }
    if int(first["pixelSamples"]) > 1:
        attributes["pixelSamples"] = int(first["pixelSamples"]) * len(parts)
    return Image(radiance.mean(axis=0), radiance.var(axis=0, ddof=1) / len(parts), attributes)
