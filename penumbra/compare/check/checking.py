"""Pictures in, a verdict out: `penumbra check` and whoever grades with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from penumbra.compare.check.diagnosis import Diagnosis, diagnose, look
from penumbra.compare.check.explanation import observations
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.picture import counts_in_name, read_picture
from penumbra.compare.check.prediction import surface_lights
from penumbra.compare.check.program import (
    BUDGET,
    SCENES,
    Examined,
    Progress,
    Subject,
    check_program,
)
from penumbra.compare.check.verdict import Verdict, verdict
from penumbra.compare.check.view import View, lead_of
from penumbra.compare.measure.image import ImageError
from penumbra.compare.run.provenance import origin
from penumbra.compare.scene import read_scene


class CheckError(ValueError):
    """Pictures that cannot be checked; the text says why."""


@dataclass(frozen=True)
class Checked:
    verdict: Verdict
    diagnosis: Diagnosis
    grids: tuple[tuple[Grid, int], ...]
    scene_file: Path
    examined: Examined | None = None
    """of a program"""

    @property
    def lead(self) -> View:
        """The picture that is spoken of"""
        return self.examined.telling.view if self.examined else lead_of(self.diagnosis.views)


def check(
    files: Sequence[Path],
    scene_file: Path,
    light_samples: int | None = None,
    pixel_samples: int | None = None,
) -> Checked:
    """Check pictures of one scene by one renderer.

    light_samples, pixel_samples: of all of them; None: as their names say (n016_aa01.png), 1 pixel
    sample where they do not. Raises CheckError, ImageError, SceneError, MissingProgramError.
    """
    scene = read_scene(scene_file)
    if not surface_lights(scene):
        raise CheckError(f"{scene_file}: has no area light: there is nothing to sample")
    if scene.point_lights:
        raise CheckError(f"{scene_file}: has a point light: only area lights can be checked")
    pictures = []
    for file in files:
        n, m = counts_in_name(file)
        n, m = light_samples or n, pixel_samples or m or 1
        if n is None:
            raise CheckError(
                f"{file}: its name does not say how many light samples it has: "
                "give --light-samples N"
            )
        pictures.append(read_picture(file, scene, n, m))
    views, grids = look(pictures, scene, scene_file)
    for file, view in zip(files, views, strict=True):
        if len(view.count) < 20:
            raise ImageError(
                f"{file}: too small to tell anything: fewer than 20 cells of 8x8 pixels"
            )
    diagnosis = diagnose(views)
    return Checked(verdict(diagnosis, grids, scene_file), diagnosis, tuple(grids), scene_file)


def check_renderer(
    subject: Subject,
    budget: float = BUDGET,
    scenes: Sequence[str] = SCENES,
    pictures: int | None = None,
    progress: Progress | None = None,
) -> Checked:
    """Check a program, which gets the scenes: what is said of it holds for all of its pictures. See
    check_program for arguments and errors."""
    examined = check_program(subject, budget, scenes, pictures, progress)
    diagnosis, grids = examined.diagnosis, examined.grids
    file = examined.telling.experiment.scene_file
    lead = examined.telling.view
    found = verdict(diagnosis, grids, file, power_known=True, lead=lead)
    found = replace(found, facts=(*found.facts, *examined.facts))
    return Checked(found, diagnosis, grids, file, examined)


def verdict_json(checked: Checked, hint: int = 3) -> dict[str, Any]:
    """All of it, for machines; less of it with a lower hint."""
    found = checked.verdict
    whole = asdict(found)
    whole["variant"] = {k: v for k, v in whole["variant"].items() if v not in ("std", 1.0)}
    whole["observed"] = observations(found)
    whole["pictures"] = [
        {
            "name": view.picture.name,
            "light_samples": view.picture.nb_light_samples,
            "pixel_samples": view.picture.samples_per_pixel,
            "law": view.picture.law,
            "grid": asdict(view.grid),
            "unexplained_outline": miss,
        }
        for view, (_, miss) in zip(checked.diagnosis.views, checked.grids, strict=True)
    ]
    examined = checked.examined
    if examined:
        for said, trial in zip(whole["pictures"], examined.trials, strict=True):
            said.update(
                name=trial.experiment.scene_file.stem,
                seed=trial.experiment.seed,
                seconds=trial.seconds,
                why=trial.why if hint > 1 else "",
            )
        whole["undecided"], whole["excluded"] = examined.undecided, examined.excluded
    whole["origin"] = origin()
    if hint < 3:
        keep = ["verdict", "confidence", "facts", "settle", "pictures", "origin"]
        keep += ["observed"] if hint > 0 else []
        keep += ["mistakes", "perhaps", "several", "regions"] if hint > 1 else []
        whole = {key: whole[key] for key in keep}
    return whole
