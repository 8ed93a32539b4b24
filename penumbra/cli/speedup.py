"""Times the C renderer with more and more threads."""

from __future__ import annotations

import argparse

from penumbra.cli.arguments import (
    Subcommands,
    add_out,
    add_scene,
    add_subcommand,
    positive,
    sample_counts,
)
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import named, plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "speedup",
        run,
        "Time the C renderer with more and more threads.",
        "penumbra speedup scenes/tp3.json -o build/speedup.csv --threads 1,2,4",
    )
    add_scene(parser)
    add_out(parser, "OUT.csv", plain(named(".csv")))
    parser.add_argument(
        "--threads",
        type=sample_counts,
        default=(),
        metavar="T",
        help="a list (1,2,4) or doublings (1..8) [up to the number of cores]",
    )
    parser.add_argument(
        "--repeats", type=positive, default=5, metavar="R", help="timings of each [5]"
    )
    parser.add_argument(
        "--light-samples", type=positive, default=1024, metavar="N", help="of each image [1024]"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.studies.speedup import speedup

    result = speedup(
        options.scene, options.out, options.threads, options.repeats, options.light_samples
    )
    print(f"{'threads':>7} {'seconds':>9} {'smallest':>9} {'largest':>9} {'speed-up':>8}")
    for row in result["rows"]:
        print(
            f"{row['threads']:>7} {row['seconds']:>9.4f} {row['low']:>9.4f} "
            f"{row['high']:>9.4f} {row['speedup']:>8.2f}"
        )
    return PASS
