"""Follows a shadow's edge along a line, exactly."""

from __future__ import annotations

import argparse

from penumbra.cli.arguments import SCENE_FILES, Subcommands, add_out, add_subcommand, scene_path
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import named


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "profile",
        run,
        "Follow the shadow along a line on the floor of the lab's scene, exactly, under the\n"
        "lights of several scenes.",
        "penumbra profile scenes/tp3.json scenes/tp3_disk.json -o build/lights/profile.json",
    )
    parser.add_argument("scenes", type=scene_path, nargs="+", metavar="SCENE", help=SCENE_FILES)
    add_out(parser, "OUT.json", named(".json"))


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.studies.profile import profile

    result = profile(options.scenes, options.out)
    print(f"{'scene':<20} {'umbra [m]':>10} {'penumbra [m]':>13}")
    for row in result["rows"]:
        print(f"{row['scene']:<20} {row['umbra']:>10.2f} {row['penumbra']:>13.2f}")
    print(f"written: {options.out}")
    return PASS
