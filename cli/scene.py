"""Prints a scene in SI units."""

from __future__ import annotations

import argparse

from cli.arguments import Subcommands, add_scene, add_subcommand
from cli.exit import PASS


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "scene",
        run,
        "Print a scene in SI units, or say what is wrong with it.",
        "penumbra scene scenes/tp3.json",
    )
    add_scene(parser)


def run(options: argparse.Namespace) -> int:
    from compare.scene import dump_scene, read_scene

    print(dump_scene(read_scene(options.scene)), end="")
    return PASS
