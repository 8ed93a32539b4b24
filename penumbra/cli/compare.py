"""Says whether an image agrees with a reference."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from penumbra.cli.arguments import (
    IMAGE_FILES,
    SCENE_FILES,
    Subcommands,
    add_subcommand,
    scene_path,
)
from penumbra.compare.run.output import named


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "compare",
        run,
        "Say whether an image agrees with a reference, region by region. Prints error metrics\n"
        "and, for each region, the bias, its 99% interval, the smallest bias that the test could\n"
        "have found, and a verdict. The exit status is 0 only if every region agrees.",
        "penumbra compare mine.exr exact --scene scenes/tp3.json",
    )
    parser.add_argument("image", type=Path, metavar="IMAGE", help=IMAGE_FILES)
    parser.add_argument(
        "reference", metavar="REFERENCE", help="an image, or `exact` for the exact solution"
    )
    parser.add_argument("--scene", type=scene_path, required=True, help=f"of both: {SCENE_FILES}")
    parser.add_argument(
        "--delta", type=_delta, metavar="D",
        help="the bias, relative to a region's mean, that still agrees [0.0005; Cycles 0.001]",
    )  # fmt: skip
    parser.add_argument(
        "--json", type=named(".json"), metavar="OUT", help="write the result as JSON too"
    )
    parser.add_argument(
        "--perceptual", action="store_true", help="HDR-FLIP and Delta E 2000 too (slow)"
    )


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.measure.agreement import compare_files, format_metrics, format_rows
    from penumbra.compare.run.output import write_json
    from penumbra.compare.run.provenance import origin

    result = compare_files(
        options.image,
        options.reference,
        options.scene,
        delta=options.delta,
        perceptual=options.perceptual,
    )
    for note in result.notes:
        print(f"penumbra: {note}", file=sys.stderr)
    print(format_metrics(result.metrics), end="\n\n")
    print(format_rows(result.rows))
    if options.json:
        content = {
            "rows": result.rows,
            "metrics": {
                region: {k: v if math.isfinite(v) else None for k, v in values.items()}
                for region, values in result.metrics.items()
            },
            "notes": result.notes,
            **origin(),
        }
        write_json(options.json, content)
    return result.exit_status


def _delta(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f'"{text}" is not a share like 0.01, above 0 and below 1')
    return value
