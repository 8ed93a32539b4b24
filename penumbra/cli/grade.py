"""penumbra grade: a class's submissions, judged, with points and reasons."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from penumbra.cli.arguments import (
    Subcommands,
    add_course,
    add_language,
    add_scheduler,
    add_subcommand,
    course_of,
    positive,
    scheduler_of,
    seconds,
)
from penumbra.cli.check import scene_named
from penumbra.cli.exit import PASS, UsageError
from penumbra.language import N_, _, language, say

if TYPE_CHECKING:
    from penumbra.grading.cage import Limits

LIMITS = (
    ("--seconds", seconds, "SECONDS", "wall time [60]"),
    ("--memory", positive, "MB", "of all its processes together [2048]"),
    ("--processes", positive, "P", "with their threads [64]"),
    ("--file-size", positive, "MB", "each file that it writes [64]"),
    ("--disk", positive, "MB", "all that it writes, or an archive holds [256]"),
    ("--output", positive, "MB", "what it prints [1]"),
)
MOST_SHOWN = 5
"""Mistakes of a class that are printed; the page has all"""


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "grade",
        run,
        "A class's submissions, judged by penumbra check, with points a claim and reasons.\n"
        "FOLDER holds a subfolder, file or archive a submission: pictures, or a program with a "
        "penumbra.toml.\n"
        "A stopped run goes on. docs/grading.md explains folder, rubric and results. Exit status 0 "
        "whatever the verdicts.",
        "penumbra grade submissions -o graded --hint 1",
        lambda options: say(
            "; what is judged is kept in {out}: the same command goes on", out=options.out
        ),
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the class's submissions")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="OUT",
        help="folder of the results: index.html, sheets, grades.json, grades.csv",
    )  # fmt: skip
    parser.add_argument(
        "--one", action="store_true", help="FOLDER itself is the only submission, for autograders"
    )
    parser.add_argument(
        "--images", default="n{light_samples}_m{pixel_samples}.png", metavar="PATTERN",
        help="how pictures are named, with {light_samples}, {pixel_samples}, {scene} and *, in any "
        "format [n{light_samples}_m{pixel_samples}.png]",
    )  # fmt: skip
    parser.add_argument(
        "--scene", default="tp3", metavar="SCENE", help="scene file, or its name in scenes/ [tp3]"
    )
    parser.add_argument(
        "--rubric", type=Path, metavar="RUBRIC.toml", help="points a claim [20 in all]"
    )
    parser.add_argument(
        "--hint", type=int, choices=range(4), default=1,
        help="how much students are told: 0 the verdict, 1 where to look, 2 the mistake and the "
        "step, 3 all [1]",
    )  # fmt: skip
    add_course(parser)
    add_language(parser)
    add_scheduler(parser)
    parser.add_argument(
        "--time-threads", action="store_true",
        help="time programs with one thread and with all, one after another once all is judged, on "
        "this machine: the one thing in the results that rests on a clock",
    )  # fmt: skip
    limits = parser.add_argument_group(
        "programs", "A submitted program runs in a cage, each build and each picture within limits."
    )
    for name, parse, metavar, text in LIMITS:
        limits.add_argument(name, type=parse, metavar=metavar, help=text)
    limits.add_argument(
        "--trust", action="store_true",
        help="run programs as you, without a cage, where none works: they can read and change "
        "whatever you can",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from penumbra.grading.cage import find_cage
    from penumbra.grading.grade import Options, pattern_of
    from penumbra.grading.gradebook import GRADES, TABLE, Class, grade_class
    from penumbra.grading.rubric import SHIPPED, read_rubric
    from penumbra.grading.submission import entries
    from penumbra.report.class_page import write_class

    out: Path = options.out
    if out.exists() and not out.is_dir():
        raise UsageError(say("-o {out}: is no folder, and the results are one", out=out))
    course = course_of(options)
    scheduler = scheduler_of(options)
    rubric_file: Path = options.rubric or SHIPPED
    rubric = read_rubric(rubric_file)
    pattern_of(options.images)
    scene_file = checkable(options.scene)
    judged = Options(
        called(scene_file),
        scene_file.read_bytes(),
        options.images,
        options.trust,
        within(options),
        language(),
    )
    asked = Class(judged, rubric, options.hint, options.time_threads)
    found = entries(options.folder, options.one, leave=[out, rubric_file])
    with tqdm(total=len(found), file=sys.stderr, unit="submission") as bar:

        def progress(done: int, of: int) -> None:
            bar.update(done - bar.n)

        grades = grade_class(found, asked, out, scheduler, options.jobs, progress)
    write_class(out, grades, course)
    print(summary(grades), end="")
    if any(one["kind"] == "program" for one in grades["submissions"]):
        cage = find_cage(options.trust)
        print(
            say("programs were held by {name}: {promise}", name=cage.name, promise=_(cage.promise))
        )
    print(
        say(
            "written: {page}, {grades}, {table}",
            page=out / "index.html",
            grades=out / GRADES,
            table=out / TABLE,
        )
    )
    return PASS


def checkable(text: str) -> Path:
    """The scene, if pictures of it can be checked. Raises UsageError, SceneError, CheckError."""
    from penumbra.compare.check.checking import Checker

    scene_file = scene_named(text)
    Checker().scene(scene_file)
    return scene_file


def called(scene_file: Path) -> str:
    """A scene's name in the results, wherever it lies."""
    from penumbra.compare.run.provenance import ROOT

    own = scene_file.resolve().parent == ROOT / "scenes"
    return f"scenes/{scene_file.name}" if own else scene_file.name


def within(options: argparse.Namespace) -> Limits:
    from penumbra.grading.cage import Limits

    mega = 1 << 20
    given = {
        "seconds": options.seconds,
        "memory": options.memory and options.memory * mega,
        "processes": options.processes,
        "file_size": options.file_size and options.file_size * mega,
        "disk": options.disk and options.disk * mega,
        "output": options.output and options.output * mega,
    }
    return Limits(**{name: value for name, value in given.items() if value is not None})


def summary(grades: dict[str, Any]) -> str:
    """A few lines for a terminal."""
    every = grades["submissions"]
    graded = [one for one in every if one["status"] == "graded"]
    words = (N_("{count} right"), N_("{count} wrong"), N_("{count} cannot tell"))
    counts = [
        say(word, count=sum(one["verdict"] == word.partition(" ")[2] for one in graded))
        for word in words
    ]
    lines = [
        say(
            "{count} submissions: {counts}, {failed} failed",
            count=len(every),
            counts=", ".join(counts),
            failed=len(every) - len(graded),
        )
    ]
    for mistake in grades["mistakes"][:MOST_SHOWN]:
        lines.append(f"{len(mistake['submissions']):4}  {mistake['title']}")
    claims = [claim["id"] for claim in grades["rubric"]["claims"]]
    untold = [(c, sum(c in one["for_instructor"] for one in every)) for c in claims]
    if said := ", ".join(
        say("{claim} of {number}", claim=claim, number=number) for claim, number in untold if number
    ):
        lines.append(say("cannot be told, and got full points: {said}", said=said))
    failed = [one for one in every if one["status"] == "failed"]
    lines += [
        say("failed: {id}: {text}", id=one["id"], text=one["problem"]["text"])
        for one in failed[:MOST_SHOWN]
    ]
    return "\n".join(lines) + "\n"
