"""penumbra check: is a student's renderer right, and if not, which mistake explains it?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from penumbra.cli.arguments import (
    IMAGE_FILES,
    SCENE_FILES,
    SCENES,
    Subcommands,
    add_course,
    add_language,
    add_subcommand,
    course_of,
    positive,
    scene_path,
    seconds,
)
from penumbra.cli.exit import CANNOT_TELL, FAIL, PASS, UsageError
from penumbra.compare.run.output import named
from penumbra.compare.run.provenance import ROOT
from penumbra.language import _, say

MADE = ROOT / "build" / "course" / "index.html"
EXIT = {"right": PASS, "wrong": FAIL, "cannot tell": CANNOT_TELL}


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "check",
        run,
        "Whether a student's pictures show the light computed correctly, and if not, which mistake "
        "explains them. Pixel grids, 8 bits, saturation, cameras and the like are said, and cost "
        "nothing. With --renderer a program is asked for the pictures that tell most. Exit status: "
        "0 right, 1 wrong, 4 cannot tell.",
        "penumbra check n016.png --scene scenes/tp3.json --light-samples 16",
    )
    parser.add_argument(
        "images", type=Path, nargs="*", metavar="IMAGE", help=f"{IMAGE_FILES}, .ppm or .npy"
    )
    parser.add_argument(
        "--renderer", metavar="COMMAND",
        help="check a program instead, '... {scene} {light_samples} {seed} {out}', which also may "
        "take {pixel_samples} {threads}: it renders penumbra's scenes, on this machine, as you",
    )  # fmt: skip
    parser.add_argument(
        "--image-suffix", default=".exr", metavar="SUFFIX",
        help=f"what {{out}} ends in: {IMAGE_FILES} [.exr]",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", type=seconds, default=60.0, metavar="SECONDS",
        help="each of COMMAND's images may take this long [60]",
    )  # fmt: skip
    parser.add_argument(
        "--budget", type=seconds, default=120.0, metavar="SECONDS",
        help="how long to look at them, beside what COMMAND takes [120]",
    )  # fmt: skip
    parser.add_argument("--scene", default="tp3", metavar="SCENE", help=f"{SCENE_FILES} [tp3]")
    parser.add_argument(
        "--light-samples", type=positive, metavar="N",
        help="light samples of the pictures, where their names (n016_aa01.png) do not say",
    )  # fmt: skip
    parser.add_argument(
        "--pixel-samples", type=positive, metavar="M", help="camera rays a pixel [1, or the name's]"
    )
    parser.add_argument(
        "--hint", type=int, choices=range(4), default=3,
        help="how much to give away: 0 the verdict, 1 where to look, 2 the mistake and the step, "
        "3 all [3]",
    )  # fmt: skip
    add_course(parser, ", or build/course where it is made")
    parser.add_argument("--json", type=named(".json"), metavar="OUT.json", help="every figure")
    parser.add_argument("--html", type=named(".html"), metavar="OUT.html", help="as a page")
    add_language(parser)


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.check.checking import check, check_renderer, verdict_json
    from penumbra.compare.check.explanation import text
    from penumbra.compare.check.program import command_program

    if bool(options.images) == bool(options.renderer):
        raise UsageError(_("give either images or --renderer COMMAND"))
    course = course_of(options) or (MADE.as_uri() if MADE.is_file() else "")
    if options.renderer:
        if options.light_samples or options.pixel_samples or options.scene != "tp3":
            raise UsageError(_("--renderer chooses scenes and samples itself"))
        checked = check_renderer(
            command_program(options.renderer, options.image_suffix, options.timeout),
            options.budget,
            progress=lambda experiment, why: print(
                say("{experiment}: {why}", experiment=experiment, why=why)
                if options.hint > 1
                else experiment,
                file=sys.stderr,
            ),
        )
    else:
        scene_file = scene_named(options.scene)
        checked = check(options.images, scene_file, options.light_samples, options.pixel_samples)
    print(text(checked.verdict, options.hint, course), end="")
    if options.json:
        from penumbra.compare.run.output import write_json

        write_json(options.json, verdict_json(checked, options.hint, course))
    if options.html:
        from penumbra.report.check_page import write_page

        write_page(options.html, checked, options.hint, course)
    return EXIT[checked.verdict.verdict]


def scene_named(text: str) -> Path:
    """A file, or one of the repository's by its name. Raises UsageError."""
    file = scene_path(text)
    if file.is_file():
        return file
    names = ", ".join(sorted(f.stem for f in SCENES.glob("*.json") if "schema" not in f.name))
    raise UsageError(
        say("--scene {text}: neither a file nor one of {names}", text=text, names=names)
    )
