"""The files that the page is made of, and the command that makes each.

Everything lies under the build folder. Images are named SCENE_nN_mM.exr: N light samples,
M pixel samples, seed 1, the scene's own size.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

LIGHT_SAMPLES = (4, 16, 64, 256)
"""figure 4 of the handout"""
PIXEL_SAMPLES = 16
"""anti-aliasing on"""
MOST_LIGHT_SAMPLES = 4096
"""of the images that agreement is tested on and that the error maps show"""
SEED = 1


class ReportError(ValueError):
    """An input that is missing or cannot be used; the text names it and what makes it."""


@dataclass(frozen=True)
class Input:
    file: str
    """path inside the build folder, with forward slashes"""
    command: str
    """run from the repository's root with the build folder named `build`"""

    def path(self, build_dir: Path) -> Path:
        return build_dir / self.file


def image_file(scene: str, light_samples: int, pixel_samples: int = 1) -> str:
    """
    >>> image_file("tp3", 64)
    'images/tp3_n64_m1.exr'
    """
    return f"images/{scene}_n{light_samples}_m{pixel_samples}.exr"


def render_command(scene: str, light_samples: int, pixel_samples: int, seed: int, out: str) -> str:
    return (
        f"build/bin/penumbra-render scenes/{scene}.json --light-samples {light_samples} "
        f"--pixel-samples {pixel_samples} --seed {seed} -o {out}"
    )


def _render(scene: str, light_samples: int, pixel_samples: int = 1) -> Input:
    file = image_file(scene, light_samples, pixel_samples)
    return Input(file, render_command(scene, light_samples, pixel_samples, SEED, f"build/{file}"))


INPUTS: tuple[Input, ...] = (
    _render("tp3_point", 1),
    _render("tp3", LIGHT_SAMPLES[0]),
    _render("tp3", LIGHT_SAMPLES[0], PIXEL_SAMPLES),
    _render("tp3", LIGHT_SAMPLES[0] * PIXEL_SAMPLES),
    _render("tp3", MOST_LIGHT_SAMPLES),
    _render("tp3_statement", 1),
    *(_render("tp3_statement", n) for n in LIGHT_SAMPLES),
    _render("tp3_statement", MOST_LIGHT_SAMPLES),
    *(
        Input(f"reference/{scene}.exr", f"make build/reference/{scene}.exr")
        for scene in ("tp3", "tp3_point", "tp3_statement")
    ),
    Input("convergence/tp3.csv", "penumbra converge scenes/tp3.json -o build/convergence/tp3"),
    Input("convergence/tp3.json", "penumbra converge scenes/tp3.json -o build/convergence/tp3"),
    Input("agreement.json", "make build/agreement.json"),
    Input("speedup.csv", "make build/speedup.csv"),
    Input("speedup.json", "make build/speedup.csv"),
)
"""Agreement holds the images of MOST_LIGHT_SAMPLES and of the point light against exact, and
the Cycles references against exact. Convergence holds pixel_samples 1 (all N) and
PIXEL_SAMPLES (a few N, 4 among them), the latter for the handout's question about noise."""


def check_inputs(build_dir: Path) -> None:
    """Raise ReportError naming each input that is not there and the command that makes it."""
    missing = [i for i in INPUTS if not i.path(build_dir).is_file()]
    if missing:
        lines = (f"{i.path(build_dir)}: no such file; make it with: {i.command}" for i in missing)
        raise ReportError(os.linesep.join(lines))
