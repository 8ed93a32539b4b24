"""Renders a scene with Cycles."""

from __future__ import annotations

import argparse

from penumbra.cli.arguments import (
    Subcommands,
    add_out,
    add_scene,
    add_size,
    add_subcommand,
    natural,
    positive,
)
from penumbra.cli.exit import PASS, UsageError
from penumbra.compare.run.output import named, plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "reference",
        run,
        "Render the identical scene with Cycles, in a process of its own. The image carries the\n"
        "variance of each pixel, from independent parts, which are kept in OUT.exr.parts/ so\n"
        "that a stopped run goes on where it was. OUT.blend is the scene, to open in Blender.",
        "penumbra reference scenes/tp3.json -o build/reference/tp3.exr --samples 256",
        lambda options: f"; the same command goes on from {options.out}.parts/",
    )
    add_scene(parser)
    add_out(parser, "OUT.exr", plain(named(".exr")))
    parser.add_argument(
        "--samples",
        type=positive,
        default=256,
        metavar="K",
        help="samples per pixel, all parts together [256]",
    )
    parser.add_argument(
        "--parts", type=positive, default=8, metavar="P", help="independent parts [8]"
    )
    parser.add_argument("--seed", type=natural, default=0, metavar="S", help="0 or more [0]")
    add_size(parser, "the scene's")
    parser.add_argument(
        "--antialias", action="store_true", help="the mean over each pixel, not its centre"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.blender_ref import reference

    if options.samples < options.parts or options.samples % options.parts:
        raise UsageError(
            f"--samples {options.samples} is not a multiple of --parts {options.parts}"
        )
    if options.parts < 2:
        raise UsageError("--parts must be 2 or more: one part shows no variance")
    reference(
        options.scene,
        options.out,
        samples=options.samples,
        parts=options.parts,
        seed=options.seed,
        width=options.width,
        height=options.height,
        antialias=options.antialias,
    )
    return PASS
