"""Saves an image as the lab does."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import IMAGE_FILES, Subcommands, add_out, add_subcommand
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import PICTURES, named


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "png",
        run,
        "Save an image as the lab does: clamped to [0, 1], times 255, no gamma.",
        "penumbra png build/images/tp3.exr -o tp3.png",
    )
    parser.add_argument("image", type=Path, metavar="IMAGE", help=IMAGE_FILES)
    add_out(parser, "OUT.png", named(*PICTURES))


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.measure.image import read_image, write_display

    write_display(options.out, read_image(options.image).radiance)
    return PASS
