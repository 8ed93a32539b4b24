"""How much faster a submitted program is with several threads, timed while nothing else runs.

Apart from everything else that is said of a submission, which no clock decides.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from penumbra.compare.check.program import FIRST
from penumbra.compare.run.provenance import ROOT, cores
from penumbra.compare.run.renderers import Job
from penumbra.compare.scene import read_scene
from penumbra.grading.fault import SubmissionFault
from penumbra.grading.grade import Options, built
from penumbra.grading.submission import Content
from penumbra.language import _

LONG_ENOUGH = 1.0
"""[s] on one thread, from which starting the program does not matter"""
FEWEST, MOST = 16, 16384
"""Light samples"""
ROUNDS = 3
"""One thread and all of them take turns, so that a machine that slows down slows both"""


def time_threads(content: Content, options: Options) -> dict[str, Any]:
    """{"threads", "ratio"}: the median time of one thread over that of as many as there are cores,
    in pictures of the lab's scene of which one thread takes LONG_ENOUGH; or {"problem"}: why not.

    Raises MissingCageError, CageError, OSError.
    """
    threads = min(cores(), options.limits.processes // 2)
    if threads < 2:
        return {"problem": _("the grader's machine has one core")}
    scene_file = ROOT / "scenes" / f"{FIRST}.json"
    scene = read_scene(scene_file)
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        out = Path(folder) / "out"

        def seconds(n: int, count: int) -> float:
            job = Job(scene_file, scene.width, scene.height, n, 1, 1, count)
            return program.renderer().run(job, out)

        try:
            with built(content, options, Path(folder)) as program:
                n = FEWEST
                while seconds(n, 1) < min(LONG_ENOUGH, options.limits.seconds / 4) and n < MOST:
                    n *= 2
                turns = [(seconds(n, 1), seconds(n, threads)) for _ in range(ROUNDS)]
        except SubmissionFault as fault:
            return {"problem": fault.text}
    alone, together = zip(*turns, strict=True)
    return {"threads": threads, "ratio": median(alone) / median(together)}
