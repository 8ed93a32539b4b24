"""Cycles as a renderer that compare.studies.convergence can put through its curves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path

from penumbra.blender_ref.process import Cycles, CyclesError, MissingBlender, fingerprint
from penumbra.compare.measure.image import write_exr
from penumbra.compare.run.renderers import Job, MissingProgramError, RendererError


class CyclesRenderer:
    """compare.run.renderers.Renderer: one process for all jobs of one scene and size.

    Its seconds are the render's own: starting Blender (about 1 s) is left out, for it is the
    same at any number of samples.
    """

    label = "cycles"
    command = "python -m penumbra.blender_ref {scene} {light_samples} {seed} {out}"
    suffix = ".exr"
    placeholders = frozenset(("scene", "light_samples", "seed", "out", "width", "height"))

    def fingerprint(self) -> str:
        try:
            return fingerprint()
        except MissingBlender as error:
            raise MissingProgramError(str(error)) from error

    def render(self, jobs: Iterable[Job], folder: Path) -> Iterator[tuple[Job, Path, float]]:
        """Each job with its image and the seconds that Cycles took for it."""
        try:
            for (scene_file, width, height), group in groupby(
                jobs, lambda job: (job.scene_file, job.width, job.height)
            ):
                with Cycles(scene_file, width, height) as cycles:
                    for job in group:
                        image = cycles.render(job.light_samples, job.seed)
                        out = folder / f"{self.label}_{job.name}.exr"
                        write_exr(out, image)
                        yield job, out, float(image.attributes["renderSeconds"])
        except MissingBlender as error:
            raise MissingProgramError(str(error)) from error
        except CyclesError as error:
            raise RendererError(str(error)) from error
