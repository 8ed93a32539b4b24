"""Pictures in, a verdict out: `penumbra check` and whoever grades with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from penumbra.compare.check.diagnosis import FINE_GRID, Diagnosis, diagnose
from penumbra.compare.check.explanation import exhibits, observations
from penumbra.compare.check.grid import Grid, fit_grid
from penumbra.compare.check.picture import Picture, counts_in_name, read_picture
from penumbra.compare.check.prediction import surface_lights
from penumbra.compare.check.program import (
    BUDGET,
    FEWEST_CELLS,
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
from penumbra.compare.scene import Scene, read_scene
from penumbra.language import say

KEPT_VIEWS = 24
Fitted = Sequence[tuple[Grid, int]]
"""Grids, and how many pixels of outline each leaves unexplained"""


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


class Checker:
    """Checks pictures, and keeps what is computed for the rays of a scene: pictures with the same
    rays, of whoever, share it. What is said of each is what it is without."""

    def __init__(self, kept: int = KEPT_VIEWS) -> None:
        self.kept = kept
        self._views: dict[tuple[Path, tuple[int, ...], Grid], View] = {}
        """the one used last is last"""
        self._scenes: dict[Path, Scene] = {}

    def scene(self, scene_file: Path) -> Scene:
        """Raises SceneError, or CheckError for one of which no picture can be checked."""
        if scene_file not in self._scenes:
            scene = read_scene(scene_file)
            if not surface_lights(scene):
                raise CheckError(
                    say(
                        "{scene_file}: has no area light: there is nothing to sample",
                        scene_file=scene_file,
                    )
                )
            if scene.point_lights:
                raise CheckError(
                    say(
                        "{scene_file}: has a point light: only area lights can be checked",
                        scene_file=scene_file,
                    )
                )
            self._scenes[scene_file] = scene
        return self._scenes[scene_file]

    def look(
        self, pictures: Sequence[Picture], scene_file: Path, given: Fitted | None = None
    ) -> tuple[list[View], Fitted]:
        """The pictures of one scene on their grids; given: these, where they are known.

        Raises SceneError, CheckError, MissingProgramError."""
        scene = self.scene(scene_file)
        fitted = given or _fit(pictures, scene)
        views: dict[tuple[tuple[int, ...], Grid], View] = {}
        found = []
        for picture, (grid, _) in zip(pictures, fitted, strict=True):
            rays = picture.values.shape, replace(grid, jittered=False)
            if rays not in views:
                views[rays] = self._view(picture, grid, scene, scene_file)
            found.append(views[rays].of(picture, grid))
        return found, fitted

    def decide(self, views: Sequence[View], fitted: Fitted, scene_file: Path) -> Checked:
        """The verdict on what was looked at. Raises MissingProgramError."""
        diagnosis = diagnose(views)
        found = verdict(diagnosis, fitted, scene_file)
        return Checked(found, diagnosis, tuple(fitted), scene_file)

    def _view(self, picture: Picture, grid: Grid, scene: Scene, scene_file: Path) -> View:
        key = scene_file, picture.values.shape, replace(grid, jittered=False)
        kept = self._views.pop(key, None)
        view = kept
        if view is None or not view.suits(picture):
            view = View(picture, grid, scene, scene_file, FINE_GRID)
        keep = kept or (None if view.recoloured else view)
        if keep is not None:
            self._views[key] = keep
            if len(self._views) > self.kept:
                self._views.pop(next(iter(self._views)))
        return view


def _fit(pictures: Sequence[Picture], scene: Scene) -> Fitted:
    """Those that take one ray a pixel have one grid."""
    single = next((p for p in pictures if p.samples_per_pixel == 1), None)
    first = fit_grid(single, scene) if single else None
    return [
        first if first and picture.samples_per_pixel == 1 else fit_grid(picture, scene)
        for picture in pictures
    ]


def too_small(view: View) -> str:
    """Why its picture tells nothing; "" if it may."""
    if len(view.count) >= FEWEST_CELLS:
        return ""
    return say(
        "{name}: too small to tell anything: fewer than {fewest_cells} cells of 8x8 pixels",
        name=view.picture.name,
        fewest_cells=FEWEST_CELLS,
    )


def check(
    files: Sequence[Path],
    scene_file: Path,
    light_samples: int | None = None,
    pixel_samples: int | None = None,
    checker: Checker | None = None,
) -> Checked:
    """Check pictures of one scene by one renderer.

    light_samples, pixel_samples: of all of them; None: as their names say (n016_aa01.png), 1 pixel
    sample where they do not. checker: that further pictures are checked with. Raises CheckError,
    ImageError, SceneError, MissingProgramError.
    """
    checker = checker or Checker()
    scene = checker.scene(scene_file)
    pictures = []
    for file in files:
        n, m = counts_in_name(file)
        n, m = light_samples or n, pixel_samples or m or 1
        if n is None:
            raise CheckError(
                say(
                    "{file}: its name does not say how many light samples it has: give "
                    "--light-samples N",
                    file=file,
                )
            )
        pictures.append(read_picture(file, scene, n, m))
    views, fitted = checker.look(pictures, scene_file)
    for view in views:
        if reason := too_small(view):
            raise ImageError(reason)
    return checker.decide(views, fitted, scene_file)


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


def verdict_json(checked: Checked, hint: int = 3, course: str = "") -> dict[str, Any]:
    """All of it, for machines; less of it with a lower hint. course: as of explanation.exhibits."""
    found = checked.verdict
    whole = asdict(found)
    whole["variant"] = {k: v for k, v in whole["variant"].items() if v not in ("std", 1.0)}
    whole["exhibits"] = exhibits((*found.mistakes, *found.perhaps), course)
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
        keep += ["mistakes", "perhaps", "exhibits", "several", "regions"] if hint > 1 else []
        whole = {key: whole[key] for key in keep}
    return whole
