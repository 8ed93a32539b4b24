"""Makes the page from what was measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import Subcommands, add_language, add_subcommand
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import named
from penumbra.compare.run.provenance import ROOT


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "report",
        run,
        "Make the page from what was rendered and measured, one file that needs no network.\n"
        "Says which inputs are missing and what makes them; `make report` makes them all.",
        "penumbra report",
    )
    parser.add_argument(
        "--build", type=Path, default=Path("build"), metavar="DIR", help="the inputs [build]"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=named(".html"),
        metavar="OUT.html",
        help="the page [DIR/report/index.html]",
    )
    add_language(parser)


def run(options: argparse.Namespace) -> int:
    from penumbra.report.build import build

    out = options.out or options.build / "report" / "index.html"
    build(options.build, out, ROOT / "scenes")
    print(f"written: {out}")
    return PASS
