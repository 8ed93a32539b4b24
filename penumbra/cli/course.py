"""Makes the lesson and what a teacher hands out."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import Subcommands, add_subcommand
from penumbra.cli.exit import PASS

MADE_OF = ("bin/penumbra-render", "lib/libmistakes.so", "wasm/core.wasm", "wasm/mistakes.wasm")
"""In the build folder"""


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "course",
        run,
        "Make the lesson, index.html, and what a teacher hands out, in French and English: static\n"
        "files for any web server or a USB stick. `make course` makes what they are made of.",
        "penumbra course -o build/course",
    )
    parser.add_argument(
        "--build", type=Path, default=Path("build"), metavar="DIR", help="the inputs [build]"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FOLDER", help="where they go [DIR/course]"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.run.renderers import MissingProgramError
    from penumbra.course.handout import write_handouts
    from penumbra.course.page import write_page

    for product in MADE_OF:
        if not (options.build / product).is_file():
            raise MissingProgramError(f"{options.build / product} is missing: run `make course`")
    out = options.out or options.build / "course"
    out.mkdir(parents=True, exist_ok=True)
    write_handouts(out)
    write_page(options.build, out / "index.html")
    print(f"written: {out}")
    return PASS
