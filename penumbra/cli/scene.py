"""Prints a scene in SI units, or as C++."""

from __future__ import annotations

import argparse

from penumbra.cli.arguments import Subcommands, add_scene, add_subcommand
from penumbra.cli.exit import PASS


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "scene",
        run,
        "Print a scene in SI units, or say what is wrong with it. As cpp, print the lines that\n"
        "build it in the lab's C++ framework, to be pasted in Scene::init().",
        "penumbra scene scenes/tp3.json --as cpp",
    )
    add_scene(parser)
    parser.add_argument(
        "--as", dest="language", choices=("si", "cpp"), default="si", help="what to print [si]"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.cpp import cpp_scene
    from penumbra.compare.scene import dump_scene, read_scene

    write = cpp_scene if options.language == "cpp" else dump_scene
    print(write(read_scene(options.scene)), end="")
    return PASS
