"""Where a shadow ray should start."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import Subcommands, add_subcommand, positive
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "self-shadow",
        run,
        "Measure where a shadow ray should start: how often four ways let a surface shadow itself\n"
        "or let light leak, against the truth, in scenes translated by 0 to 1e7 and scaled by\n"
        "1e-6 to 1e6, in float32 and float64.",
        "penumbra self-shadow -o build/stability/self_shadow",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=plain(Path),
        metavar="OUT",
        default=Path("build", "stability", "self_shadow"),
        help="writes OUT.csv and OUT.json [build/stability/self_shadow]",
    )
    parser.add_argument(
        "--rays", type=positive, default=4096, metavar="N", help="of each scene and place [4096]"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.studies.self_shadow import verdict_lines, write_map

    for line in verdict_lines(write_map(options.out, options.rays)["verdict"]):
        print(line)
    print(f"written: {options.out}.csv and {options.out}.json")
    return PASS
