"""penumbra calibrate: how often is `penumbra check` wrong?"""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import (
    Subcommands,
    add_out,
    add_scheduler,
    add_subcommand,
    positive,
    scheduler_of,
)
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import named, plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "calibrate",
        run,
        "How often `penumbra check` is wrong: pictures of correct renderers and of every mistake,\n"
        "in every form that students save, and what is said of each. A stopped run goes on.",
        "penumbra calibrate -o docs/calibration.json",
    )
    add_out(parser, "OUT.json", plain(named(".json")))
    parser.add_argument(
        "--cases", type=positive, default=2, metavar="K",
        help="pictures of each choice of the catalogue, at 16 light samples and more [2]",
    )  # fmt: skip
    parser.add_argument(
        "--correct", type=positive, default=505, metavar="C", help="correct renderers [505]"
    )
    parser.add_argument(
        "--seed", type=positive, default=3, metavar="S",
        help="of the draw [3]; prices and tolerances were set on 1 and 2",
    )  # fmt: skip
    parser.add_argument(
        "--reduced", action="store_true", help="the few of the tests: a minute instead of 10"
    )
    add_scheduler(parser)


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.check.calibration import study

    out: Path = options.out
    found = study(
        out,
        options.cases,
        options.correct,
        options.seed,
        options.reduced,
        options.jobs,
        scheduler_of(options),
    )
    right, detected, first, unknown = (
        found[key] for key in ("correct", "detected", "named", "unknown")
    )
    print(
        f"correct: {right['accused']} of {right['n']} accused (below {right['upper']:.2%}), "
        f"{right['cannot_tell']} cannot tell"
    )
    print(f"found: {detected['found']} of {detected['n']} mistakes that show at N >= 16")
    print(f"named: {first['first']} of {first['n']}")
    print(
        f"not in the catalogue: {unknown['unknown']} of {unknown['n']} unknown, "
        f"{unknown['nearest']} given another name"
    )
    print(f"written: {out}")
    return PASS
