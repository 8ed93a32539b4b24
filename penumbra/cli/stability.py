"""Where floats break."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import Subcommands, add_subcommand
from penumbra.cli.exit import FAIL, PASS
from penumbra.compare.run.output import plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "stability",
        run,
        "Where floats break: scenes at the extremes in float32 and float64. Against the same\n"
        "estimate in extended precision, and against the exact solution; the light's size against\n"
        "translation; pixels near a light; sums of many samples.",
        "penumbra stability -o build/stability/stability",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=plain(Path),
        default=Path("build", "stability", "stability"),
        metavar="OUT",
        help="writes OUT.csv, OUT.json and OUT_scenes/ [build/stability/stability]",
    )
    parser.add_argument(
        "--budget", choices=("full", "small"), default="full", help="small: fewer values [full]"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.studies.stability import study

    result = study(options.out, options.budget)
    bad = {kind: result[kind] for kind in ("nan", "inf", "negative")}
    print(f"{result['images']} images: " + ", ".join(f"{n} {kind}" for kind, n in bad.items()))
    print(f"written: {options.out}.csv and {options.out}.json")
    return FAIL if any(bad.values()) else PASS
