"""What each millisecond buys."""

from __future__ import annotations

import argparse
from pathlib import Path

from penumbra.cli.arguments import (
    Subcommands,
    add_cycles,
    add_scene,
    add_scheduler,
    add_size,
    add_subcommand,
    errors,
    positive,
    sample_counts,
    scheduler_of,
    seconds,
)
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import plain


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "trade",
        run,
        "Measure what each millisecond buys: error by region against time, for every sampler and\n"
        "estimator of the C renderer, N and number of threads, and say which to use. Each setting\n"
        "is timed warm, in one process; errors are against the exact image.",
        "penumbra trade scenes/tp3.json -o build/trade/tp3 \\\n"
        "           --verify scenes/small_light.json scenes/three_spheres.json --cycles",
        lambda options: "; nothing was written",
    )
    add_scene(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=plain(Path),
        metavar="OUT",
        help="writes OUT.csv and OUT.json [build/trade/SCENE]",
    )
    parser.add_argument(
        "--verify",
        type=Path,
        nargs="+",
        default=[],
        metavar="SCENE",
        help="try what is recommended on these scenes too",
    )
    add_cycles(parser, "1,4,8,16")
    parser.add_argument(
        "--targets",
        type=errors,
        default="3,1,0.3,0.1",
        metavar="E",
        help="relative RMSE to recommend a setting for, in percent [3,1,0.3,0.1]",
    )
    parser.add_argument(
        "--light-samples",
        type=sample_counts,
        default="1..16384",
        metavar="N",
        help="doublings (1..4096) or a list (1,16,64), as far as --max-seconds lets [1..16384]",
    )
    parser.add_argument(
        "--max-seconds",
        type=seconds,
        default=0.05,
        metavar="S",
        help="leave out N of which an image takes longer [0.05]",
    )
    parser.add_argument(
        "--threads",
        type=sample_counts,
        default=(),
        metavar="T",
        help="a list (1,2,4) or doublings (1..8) [1 and the number of cores]",
    )
    parser.add_argument("--seeds", type=positive, default=6, metavar="K", help="frames of each [6]")
    add_size(parser, "the scene's")
    parser.add_argument(
        "--keep-images",
        action="store_true",
        help="images of equal time and of equal error, for the report, in OUT_images/",
    )
    add_scheduler(parser, jobs=False)


def run(options: argparse.Namespace) -> int:
    from penumbra.blender_ref import CyclesRenderer
    from penumbra.compare.studies.trade import TradeStudy, trade

    out = options.out or Path("build", "trade", options.scene.stem)
    result = trade(
        TradeStudy(
            options.scene,
            out,
            tuple(options.verify),
            cycles=CyclesRenderer() if options.cycles else None,
            cycles_light_samples=options.cycles or (),
            light_samples=options.light_samples,
            threads=options.threads,
            seeds=options.seeds,
            targets=options.targets,
            max_seconds=options.max_seconds,
            width=options.width,
            height=options.height,
            keep_images=options.keep_images,
        ),
        scheduler_of(options),
    )
    for answer in result["answers"]:
        print(answer["text"])
    for trial in result["trials"]:
        if trial["verdict"] != "no choice":
            print(trial["text"])
    print(result["verdict"])
    print(f"written: {out}.csv and {out}.json")
    return PASS
