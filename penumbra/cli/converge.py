"""Error against the number of light samples, for any renderer."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from penumbra.cli.arguments import (
    IMAGE_FILES,
    Subcommands,
    add_cycles,
    add_scene,
    add_scheduler,
    add_size,
    add_subcommand,
    positive,
    sample_counts,
    scheduler_of,
    seconds,
)
from penumbra.cli.exit import PASS
from penumbra.compare.run.output import plain

if TYPE_CHECKING:
    from penumbra.compare.run.renderers import Renderer
    from penumbra.compare.studies.convergence import Curve


def add(subcommands: Subcommands) -> None:
    parser = add_subcommand(
        subcommands,
        "converge",
        run,
        "Measure how a renderer's error falls with the number of light samples. Renders\n"
        "N = 1, 2, 4, ... with several seeds, measures the error against the exact image (and a\n"
        "Cycles reference) in lit, penumbra and umbra, and fits the slope of log RMSE against\n"
        "log N: -1/2 for independent samples, 0 if N changes nothing. A run that was stopped\n"
        "goes on where it was when the same command is given again.",
        "penumbra converge scenes/tp3.json -o build/convergence/mine \\\n"
        '           --renderer "./mine {scene} {light_samples} {seed} {out}" --seeds 4',
        kept,
    )
    add_scene(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=plain(Path),
        metavar="OUT",
        help="writes OUT.csv and OUT.json [build/convergence/SCENE]",
    )
    parser.add_argument(
        "--renderer",
        action="append",
        metavar="CMD",
        help="a command with {scene} {light_samples} {seed} {out} and, where it takes them, "
        "{width} {height} {pixel_samples} {threads}; run without a shell; or `penumbra` or "
        "`cycles`. May be repeated [penumbra]",
    )
    parser.add_argument(
        "--label", action="append", help="name of each --renderer [its program's name]"
    )
    parser.add_argument(
        "--image-suffix",
        default=".exr",
        metavar="SUFFIX",
        help=f"what {{out}} ends in: {IMAGE_FILES} [.exr]",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=600.0,
        metavar="S",
        help="seconds that one image may take [600]",
    )
    add_cycles(parser, "1..256")
    parser.add_argument(
        "--reference",
        type=Path,
        metavar="REF.exr",
        help="measure against this Cycles reference too; its own noise is subtracted",
    )
    parser.add_argument(
        "--light-samples",
        type=sample_counts,
        default="1..4096",
        metavar="N",
        help="doublings (1..4096) or a list (1,16,64) [1..4096]",
    )
    parser.add_argument(
        "--seeds",
        type=positive,
        default=4,
        metavar="K",
        help="images for each N; intervals need 2 [4]",
    )
    parser.add_argument(
        "--pixel-samples",
        type=sample_counts,
        default="1",
        metavar="M",
        help="anti-aliasing, a list (1,16); 1 is the pixel's centre [1]",
    )
    parser.add_argument(
        "--max-shadow-rays",
        type=positive,
        default=1024,
        metavar="R",
        help="for M > 1, leave out N with N x M above R [1024]",
    )
    parser.add_argument(
        "--pixel-grid",
        type=positive,
        default=4,
        metavar="K",
        help="for M > 1, the exact image is the mean over K x K positions [4]",
    )
    add_size(
        parser, "the reference's, else 300 across if the renderers take a size, else the scene's"
    )
    parser.add_argument("--keep-images", action="store_true", help="keep the images in OUT_images/")
    add_scheduler(parser, jobs=False)


def run(options: argparse.Namespace) -> int:
    from penumbra.compare.studies.convergence import ConvergenceStudy, converge

    out = _out(options)
    study = ConvergenceStudy(
        options.scene,
        out,
        tuple(_curves(options)),
        seeds=options.seeds,
        width=options.width,
        height=options.height,
        reference=options.reference,
        max_shadow_rays=options.max_shadow_rays,
        pixel_grid=options.pixel_grid,
        keep_images=options.keep_images,
    )
    result = converge(study, scheduler_of(options))
    _print_slopes(result)
    print(f"written: {out}.csv and {out}.json")
    return PASS


def _out(options: argparse.Namespace) -> Path:
    return Path(options.out or Path("build", "convergence", options.scene.stem))


def kept(options: argparse.Namespace) -> str:
    return (
        f"; what was measured so far is in {_out(options)}.journal, "
        "and the same command goes on from there"
    )


def _curves(options: argparse.Namespace) -> list[Curve]:
    from penumbra.blender_ref import CyclesRenderer
    from penumbra.compare.run.renderers import CommandRenderer, penumbra_renderer
    from penumbra.compare.studies.convergence import ConvergenceError, Curve

    commands = options.renderer or ["penumbra"]
    labels = options.label or []
    if labels and len(labels) != len(commands):
        raise ConvergenceError(f"{len(labels)} --label for {len(commands)} --renderer")
    curves = []
    for i, command in enumerate(commands):
        renderer: Renderer
        if command == "penumbra":
            renderer = penumbra_renderer(options.timeout)
        elif command == "cycles":
            renderer = CyclesRenderer()
        else:
            label = labels[i] if labels else _program_name(command)
            renderer = CommandRenderer(label, command, options.image_suffix, options.timeout)
        curves.append(Curve(renderer, options.light_samples, options.pixel_samples))
    if options.cycles:
        curves.append(Curve(CyclesRenderer(), options.cycles))
    return curves


def _program_name(command: str) -> str:
    words = command.split()
    return Path(words[0]).stem if words else "renderer"


def _print_slopes(result: dict[str, Any]) -> None:
    print(
        f"{result['scene']}, {result['width']}x{result['height']}, {result['seeds']} seeds: "
        "slope of log RMSE against log N"
    )
    print(f"{'renderer':<12} {'M':>3} {'region':<20} {'against':<7} {'slope':>7}  95% interval")
    for row in result["slopes"]:
        name = f"{row['renderer']:<12} {row['pixel_samples']:>3} {row['region']:<20}"
        if row["low"] is None:
            interval = "unknown: the seed changes nothing, or there is one only"
        else:
            interval = f"{row['low']:.4f} to {row['high']:.4f}"
        print(f"{name} {row['against']:<7} {row['slope']:>7.4f}  {interval}")
    for row in result["without_slope"]:
        name = f"{row['renderer']:<12} {row['pixel_samples']:>3} {row['region']:<20}"
        print(f"{name} {row['against']:<7} {'-':>7}  {row['reason']}")
