"""The command line: the one place that knows all the parts.

Each subcommand imports what it needs when it runs, since some parts take seconds to load and
others may not be installed.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compare.run.output import PICTURES, named
from compare.run.provenance import ROOT
from compare.run.provenance import VERSION as __version__

if TYPE_CHECKING:
    from compare.run.renderers import Renderer
    from compare.studies.convergence import Curve

PASS, FAIL, USAGE, MISSING, SIGNALLED = 0, 1, 2, 3, 128
"""Exit codes: done; a check failed; wrong usage, bad input or unwritable output; a program or
library is missing; SIGNALLED + n: ended by signal n, as a shell says it (130 is Ctrl-C)."""


IMAGE_FILES = ".exr, .pfm, .hdr, .png, .jpg or .bmp"


class UsageError(ValueError):
    """Options that do not go together; the text says which."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand; its exit code. Errors meant for the user are one sentence on stderr.

    Without arguments those of the process are meant, which ends afterwards: SIGINT and SIGTERM
    no longer change its exit status then.
    """
    if sys.stdout is None:  # closed, by `>&-`: what is printed then fails, rather than vanish
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
    stopped_by: list[int] = []

    def stop(number: int, frame: object) -> None:
        stopped_by.append(number)
        raise KeyboardInterrupt

    def ignore_signals() -> None:
        if arguments is None:
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)

    options = argparse.Namespace(kept=lambda _: "")
    try:
        for number in (signal.SIGINT, signal.SIGTERM):  # `timeout` and `kill` clean up too
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, stop)
        try:
            options = _parser().parse_args(arguments)
            done = int(options.run(options))
        finally:
            _flush_output()
        ignore_signals()  # all is written: else Python's own end would die of them in silence
        return done
    except (KeyboardInterrupt, Exception) as error:
        ignore_signals()
        if stopped_by:  # an import that is stopped may fail as if something were missing
            print(f"penumbra: stopped{options.kept(options)}", file=sys.stderr)
            return SIGNALLED + stopped_by[0]
        if isinstance(error, BrokenPipeError):  # `penumbra scene ... | head`
            return SIGNALLED + signal.SIGPIPE
        status = _exit_code(error)
        if status is None:
            raise
        print(f"penumbra: {_sentence(error)}", file=sys.stderr)
        return status


def _flush_output() -> None:
    """A short text meets a full disk or a closed pipe only now. Raises OSError."""
    try:
        sys.stdout.flush()
    except OSError as error:
        # Nowhere to go: else Python tries again when it ends, and fails its own way.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(error.errno, error.strerror, "standard output") from error


def _sentence(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:  # of no file: print's
        return f"{error.filename or 'standard output'}: {error.strerror}"
    return str(error)


def _exit_code(error: BaseException) -> int | None:
    """Our own exceptions, and the system's about files, say all; others are our bugs: None."""
    if isinstance(error, ImportError):  # a library, or bpy: MissingBlender is one
        return MISSING
    if isinstance(error, UsageError | OSError):
        return USAGE
    if type(error).__module__.partition(".")[0] in ("blender_ref", "compare", "report"):
        return int(getattr(error, "exit_code", USAGE))
    return None


# ---------------------------------------------------------------- subcommands


def _scene(options: argparse.Namespace) -> int:
    from compare.scene import dump_scene, read_scene

    print(dump_scene(read_scene(options.scene)), end="")
    return PASS


def _reference(options: argparse.Namespace) -> int:
    from blender_ref import reference

    if options.samples < options.parts or options.samples % options.parts:
        raise UsageError(
            f"--samples {options.samples} is not a multiple of --parts {options.parts}"
        )
    if options.parts < 2:
        raise UsageError("--parts must be 2 or more: one part shows no variance")
    reference(
        options.scene,
        options.out,
        samples=options.samples,
        parts=options.parts,
        seed=options.seed,
        width=options.width,
        height=options.height,
        antialias=options.antialias,
    )
    return PASS


def _exact(options: argparse.Namespace) -> int:
    import numpy as np

    from compare.exact.image import exact_image
    from compare.measure.image import Image, write_exr
    from compare.scene import read_scene

    scene = read_scene(options.scene)
    exact = exact_image(scene, options.width, options.height, options.pixel_grid)
    attributes: dict[str, str | int | float] = {
        "sceneName": scene.name,
        "sceneHash": scene.hash,
        "sampler": "exact",
        "pixelGrid": options.pixel_grid,
        "errorBound": float(exact.error_bound.max()),
        "software": f"penumbra {__version__}",
    }
    write_exr(options.out, Image(exact.radiance, np.zeros_like(exact.radiance), attributes))
    return PASS


def _compare(options: argparse.Namespace) -> int:
    from compare.measure.agreement import compare_files, format_metrics, format_rows
    from compare.run.output import write_json
    from compare.run.provenance import command_line, machine, versions

    result = compare_files(
        options.image, options.reference, options.scene, perceptual=options.perceptual
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
            "command": command_line(),
            "machine": machine(),
            "versions": versions(),
        }
        write_json(options.json, content)
    return result.exit_status


def _png(options: argparse.Namespace) -> int:
    from compare.measure.image import read_image, write_display

    write_display(options.out, read_image(options.image).radiance)
    return PASS


def _converge(options: argparse.Namespace) -> int:
    from compare.studies.convergence import Study, converge

    out = _converge_out(options)
    study = Study(
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
    result = converge(study)
    _print_slopes(result)
    print(f"written: {out}.csv and {out}.json")
    return PASS


def _converge_out(options: argparse.Namespace) -> Path:
    return Path(options.out or Path("build", "convergence", options.scene.stem))


def _converge_kept(options: argparse.Namespace) -> str:
    return (
        f"; what was measured so far is in {_converge_out(options)}.journal, "
        "and the same command goes on from there"
    )


def _curves(options: argparse.Namespace) -> list[Curve]:
    from compare.run.renderers import CommandRenderer, penumbra_renderer
    from compare.studies.convergence import ConvergenceError, Curve

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
            renderer = _cycles()
        else:
            label = labels[i] if labels else _program_name(command)
            renderer = CommandRenderer(label, command, options.image_suffix, options.timeout)
        curves.append(Curve(renderer, options.light_samples, options.pixel_samples))
    if options.cycles:
        curves.append(Curve(_cycles(), options.cycles))
    return curves


def _cycles() -> Renderer:
    from blender_ref import CyclesRenderer

    return CyclesRenderer()


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


def _speedup(options: argparse.Namespace) -> int:
    from compare.studies.speedup import speedup

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


def _trade(options: argparse.Namespace) -> int:
    from compare.studies.trade import Study, trade

    out = options.out or Path("build", "trade", options.scene.stem)
    result = trade(
        Study(
            options.scene,
            out,
            tuple(options.verify),
            cycles=_cycles() if options.cycles else None,
            cycles_light_samples=options.cycles or (),
            light_samples=options.light_samples,
            threads=options.threads,
            seeds=options.seeds,
            targets=options.targets,
            max_seconds=options.max_seconds,
            width=options.width,
            height=options.height,
            keep_images=options.keep_images,
        )
    )
    for answer in result["answers"]:
        print(answer["text"])
    for trial in result["trials"]:
        if trial["verdict"] != "no choice":
            print(trial["text"])
    print(result["verdict"])
    print(f"written: {out}.csv and {out}.json")
    return PASS


def _stability(options: argparse.Namespace) -> int:
    from compare.studies.stability import study

    result = study(options.out, options.budget)
    bad = {kind: result[kind] for kind in ("nan", "inf", "negative")}
    print(f"{result['images']} images: " + ", ".join(f"{n} {kind}" for kind, n in bad.items()))
    print(f"written: {options.out}.csv and {options.out}.json")
    return FAIL if any(bad.values()) else PASS


def _self_shadow(options: argparse.Namespace) -> int:
    from compare.studies.self_shadow import verdict_lines, write_map

    for line in verdict_lines(write_map(options.out, options.rays)["verdict"]):
        print(line)
    print(f"written: {options.out}.csv and {options.out}.json")
    return PASS


def _report(options: argparse.Namespace) -> int:
    from report.build import build

    out = options.out or options.build / "report" / "index.html"
    build(options.build, out, ROOT / "scenes")
    print(f"written: {out}")
    return PASS


# ---------------------------------------------------------------- arguments


def sample_counts(text: str) -> tuple[int, ...]:
    """
    >>> sample_counts("1..16")
    (1, 2, 4, 8, 16)
    >>> sample_counts("64,4,16")
    (4, 16, 64)
    """
    try:
        if ".." in text:
            first, last = (int(end) for end in text.split(".."))
            if not 1 <= first <= last:
                raise ValueError
            return tuple(first << i for i in range((last // first).bit_length()))
        counts = sorted({int(word) for word in text.split(",")})
        if counts[0] < 1:
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'"{text}" is neither a list like 1,4,16 nor doublings like 1..4096'
        ) from None
    return tuple(counts)


def positive(text: str) -> int:
    value = int(text) if text.strip().isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f'"{text}" is not a whole number of 1 or more')
    return value


def natural(text: str) -> int:
    return 0 if text.strip() == "0" else positive(text)


def seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number of seconds above 0')
    return value


def errors(text: str) -> tuple[float, ...]:
    """
    >>> errors("3,0.1")
    (0.03, 0.001)
    """
    try:
        values = sorted({float(word) / 100 for word in text.split(",")}, reverse=True)
    except ValueError:
        values = [0.0]
    if not all(0 < value < 1 for value in values):
        raise argparse.ArgumentTypeError(f'"{text}" is not a list of percentages like 3,1,0.3')
    return tuple(values)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="penumbra",
        description="Soft shadows: renders compared with Cycles and with the exact answer.",
        epilog="exit status: 0 done, 1 a check failed, 2 usage, bad input or unwritable output, "
        "3 something is not installed or not built, 128 + n ended by\n"
        "signal n (130 is Ctrl-C).\n"
        "`penumbra SUBCOMMAND --help` explains each with an example.",
        formatter_class=_help,
    )
    parser.add_argument("--version", action="version", version=f"penumbra {__version__}")
    subcommands = parser.add_subparsers(required=True, metavar="SUBCOMMAND")

    def add(
        name: str, run: Any, text: str, example: str, kept: Any = lambda options: ""
    ) -> argparse.ArgumentParser:
        sub = subcommands.add_parser(
            name,
            help=text.partition(".")[0],
            description=text,
            epilog=f"example: {example}",
            formatter_class=_help,
        )
        sub.set_defaults(run=run, kept=kept)
        return sub

    _add_scene_commands(add)
    _add_converge(add)
    _add_speedup(add)
    _add_trade(add)
    _add_stability(add)
    _add_self_shadow(add)
    _add_report(add)
    return parser


def _add_scene_commands(add: Any) -> None:
    scene = add(
        "scene",
        _scene,
        "Print a scene in SI units, or say what is wrong with it.",
        "penumbra scene scenes/tp3.json",
    )
    _scene_argument(scene)

    reference = add(
        "reference",
        _reference,
        "Render the identical scene with Cycles, in a process of its own. The image carries the\n"
        "variance of each pixel, from independent parts, which are kept in OUT.exr.parts/ so\n"
        "that a stopped run goes on where it was. OUT.blend is the scene, to open in Blender.",
        "penumbra reference scenes/tp3.json -o build/reference/tp3.exr --samples 256",
        lambda options: f"; the same command goes on from {options.out}.parts/",
    )
    _scene_argument(reference)
    _out_argument(reference, "OUT.exr", ".exr")
    reference.add_argument(
        "--samples",
        type=positive,
        default=256,
        metavar="K",
        help="samples per pixel, all parts together [256]",
    )
    reference.add_argument(
        "--parts", type=positive, default=8, metavar="P", help="independent parts [8]"
    )
    reference.add_argument("--seed", type=natural, default=0, metavar="S", help="0 or more [0]")
    _size_arguments(reference, "the scene's")
    reference.add_argument(
        "--antialias", action="store_true", help="the mean over each pixel, not its centre"
    )

    exact = add(
        "exact",
        _exact,
        "Compute the image without noise, penumbra included.",
        "penumbra exact scenes/tp3.json -o build/exact/tp3.exr",
    )
    _scene_argument(exact)
    _out_argument(exact, "OUT.exr", ".exr")
    _size_arguments(exact, "the scene's")
    exact.add_argument(
        "--pixel-grid",
        type=positive,
        default=1,
        metavar="K",
        help="mean over K x K positions in each pixel; 1 is the pixel's centre [1]",
    )

    compare = add(
        "compare",
        _compare,
        "Say whether an image agrees with a reference, region by region. Prints error metrics\n"
        "and, for each region, the bias, its 99% interval, the smallest bias that the test could\n"
        "have found, and a verdict. The exit status is 0 only if every region agrees.",
        "penumbra compare mine.exr exact --scene scenes/tp3.json",
    )
    compare.add_argument("image", type=Path, metavar="IMAGE", help=IMAGE_FILES)
    compare.add_argument(
        "reference", metavar="REFERENCE", help="an image, or `exact` for the exact solution"
    )
    compare.add_argument("--scene", type=Path, required=True, help="scene file of both")
    compare.add_argument(
        "--json", type=named(".json"), metavar="OUT", help="write the result as JSON too"
    )
    compare.add_argument(
        "--perceptual", action="store_true", help="HDR-FLIP and Delta E 2000 too (slow)"
    )

    png = add(
        "png",
        _png,
        "Save an image as the lab does: clamped to [0, 1], times 255, no gamma.",
        "penumbra png build/images/tp3.exr -o tp3.png",
    )
    png.add_argument("image", type=Path, metavar="IMAGE", help=IMAGE_FILES)
    _out_argument(png, "OUT.png", *PICTURES)


def _add_converge(add: Any) -> None:
    converge = add(
        "converge",
        _converge,
        "Measure how a renderer's error falls with the number of light samples. Renders\n"
        "N = 1, 2, 4, ... with several seeds, measures the error against the exact image (and a\n"
        "Cycles reference) in lit, penumbra and umbra, and fits the slope of log RMSE against\n"
        "log N: -1/2 for independent samples, 0 if N changes nothing. A run that was stopped\n"
        "goes on where it was when the same command is given again.",
        "penumbra converge scenes/tp3.json -o build/convergence/mine \\\n"
        '           --renderer "./mine {scene} {light_samples} {seed} {out}" --seeds 4',
        _converge_kept,
    )
    _scene_argument(converge)
    converge.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="OUT",
        help="writes OUT.csv and OUT.json [build/convergence/SCENE]",
    )
    converge.add_argument(
        "--renderer",
        action="append",
        metavar="CMD",
        help="a command with {scene} {light_samples} {seed} {out} and, where it takes them, "
        "{width} {height} {pixel_samples} {threads}; run without a shell; or `penumbra` or "
        "`cycles`. May be repeated [penumbra]",
    )
    converge.add_argument(
        "--label", action="append", help="name of each --renderer [its program's name]"
    )
    converge.add_argument(
        "--image-suffix",
        default=".exr",
        metavar="SUFFIX",
        help=f"what {{out}} ends in: {IMAGE_FILES} [.exr]",
    )
    converge.add_argument(
        "--timeout",
        type=seconds,
        default=600.0,
        metavar="S",
        help="seconds that one image may take [600]",
    )
    converge.add_argument(
        "--cycles",
        nargs="?",
        type=sample_counts,
        const=sample_counts("1..256"),
        metavar="N",
        help="Cycles too, with these numbers of samples [1..256]",
    )
    converge.add_argument(
        "--reference",
        type=Path,
        metavar="REF.exr",
        help="measure against this Cycles reference too; its own noise is subtracted",
    )
    converge.add_argument(
        "--light-samples",
        type=sample_counts,
        default="1..4096",
        metavar="N",
        help="doublings (1..4096) or a list (1,16,64) [1..4096]",
    )
    converge.add_argument(
        "--seeds",
        type=positive,
        default=4,
        metavar="K",
        help="images for each N; intervals need 2 [4]",
    )
    converge.add_argument(
        "--pixel-samples",
        type=sample_counts,
        default="1",
        metavar="M",
        help="anti-aliasing, a list (1,16); 1 is the pixel's centre [1]",
    )
    converge.add_argument(
        "--max-shadow-rays",
        type=positive,
        default=1024,
        metavar="R",
        help="for M > 1, leave out N with N x M above R [1024]",
    )
    converge.add_argument(
        "--pixel-grid",
        type=positive,
        default=4,
        metavar="K",
        help="for M > 1, the exact image is the mean over K x K positions [4]",
    )
    _size_arguments(
        converge, "the reference's, else 300 across if the renderers take a size, else the scene's"
    )
    converge.add_argument(
        "--keep-images", action="store_true", help="keep the images in OUT_images/"
    )


def _add_speedup(add: Any) -> None:
    sub = add(
        "speedup",
        _speedup,
        "Time the C renderer with more and more threads.",
        "penumbra speedup scenes/tp3.json -o build/speedup.csv --threads 1,2,4",
    )
    _scene_argument(sub)
    _out_argument(sub, "OUT.csv", ".csv")
    sub.add_argument(
        "--threads",
        type=sample_counts,
        default=(),
        metavar="T",
        help="a list (1,2,4) or doublings (1..8) [up to the number of cores]",
    )
    sub.add_argument("--repeats", type=positive, default=5, metavar="R", help="timings of each [5]")
    sub.add_argument(
        "--light-samples", type=positive, default=1024, metavar="N", help="of each image [1024]"
    )


def _add_trade(add: Any) -> None:
    sub = add(
        "trade",
        _trade,
        "Measure what each millisecond buys: error by region against time, for every sampler and\n"
        "estimator of the C renderer, N and number of threads, and say which to use. Each setting\n"
        "is timed warm, in one process; errors are against the exact image.",
        "penumbra trade scenes/tp3.json -o build/trade/tp3 \\\n"
        "           --verify scenes/small_light.json scenes/three_spheres.json --cycles",
        lambda options: "; nothing was written",
    )
    _scene_argument(sub)
    sub.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="OUT",
        help="writes OUT.csv and OUT.json [build/trade/SCENE]",
    )
    sub.add_argument(
        "--verify",
        type=Path,
        nargs="+",
        default=[],
        metavar="SCENE",
        help="try what is recommended on these scenes too",
    )
    sub.add_argument(
        "--cycles",
        nargs="?",
        type=sample_counts,
        const=sample_counts("1,4,8,16"),
        metavar="N",
        help="Cycles too, with these numbers of samples [1,4,8,16]",
    )
    sub.add_argument(
        "--targets",
        type=errors,
        default="3,1,0.3,0.1",
        metavar="E",
        help="relative RMSE to recommend a setting for, in percent [3,1,0.3,0.1]",
    )
    sub.add_argument(
        "--light-samples",
        type=sample_counts,
        default="1..16384",
        metavar="N",
        help="doublings (1..4096) or a list (1,16,64), as far as --max-seconds lets [1..16384]",
    )
    sub.add_argument(
        "--max-seconds",
        type=seconds,
        default=0.05,
        metavar="S",
        help="leave out N of which an image takes longer [0.05]",
    )
    sub.add_argument(
        "--threads",
        type=sample_counts,
        default=(),
        metavar="T",
        help="a list (1,2,4) or doublings (1..8) [1 and the number of cores]",
    )
    sub.add_argument("--seeds", type=positive, default=6, metavar="K", help="frames of each [6]")
    _size_arguments(sub, "the scene's")
    sub.add_argument(
        "--keep-images",
        action="store_true",
        help="images of equal time and of equal error, for the report, in OUT_images/",
    )


def _add_stability(add: Any) -> None:
    stability = add(
        "stability",
        _stability,
        "Where floats break: scenes at the extremes in float32 and float64. Against the same\n"
        "estimate in extended precision, and against the exact solution; the light's size against\n"
        "translation; pixels near a light; sums of many samples.",
        "penumbra stability -o build/stability/stability",
    )
    stability.add_argument(
        "-o",
        "--out",
        type=Path,
        default=Path("build", "stability", "stability"),
        metavar="OUT",
        help="writes OUT.csv, OUT.json and OUT_scenes/ [build/stability/stability]",
    )
    stability.add_argument(
        "--budget", choices=("full", "small"), default="full", help="small: fewer values [full]"
    )


def _add_self_shadow(add: Any) -> None:
    sub = add(
        "self-shadow",
        _self_shadow,
        "Measure where a shadow ray should start: how often four ways let a surface shadow itself\n"
        "or let light leak, against the truth, in scenes translated by 0 to 1e7 and scaled by\n"
        "1e-6 to 1e6, in float32 and float64.",
        "penumbra self-shadow -o build/stability/self_shadow",
    )
    sub.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="OUT",
        default=Path("build", "stability", "self_shadow"),
        help="writes OUT.csv and OUT.json [build/stability/self_shadow]",
    )
    sub.add_argument(
        "--rays", type=positive, default=4096, metavar="N", help="of each scene and place [4096]"
    )


def _add_report(add: Any) -> None:
    sub = add(
        "report",
        _report,
        "Make the page from what was rendered and measured, one file that needs no network.\n"
        "Says which inputs are missing and what makes them; `make report` makes them all.",
        "penumbra report",
    )
    sub.add_argument(
        "--build", type=Path, default=Path("build"), metavar="DIR", help="the inputs [build]"
    )
    sub.add_argument(
        "-o",
        "--out",
        type=named(".html"),
        metavar="OUT.html",
        help="the page [DIR/report/index.html]",
    )


def _help(prog: str) -> argparse.HelpFormatter:
    return argparse.RawDescriptionHelpFormatter(prog, max_help_position=28)


def _scene_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file, scenes/*.json")


def _out_argument(parser: argparse.ArgumentParser, metavar: str, *endings: str) -> None:
    parser.add_argument("-o", "--out", type=named(*endings), required=True, metavar=metavar)


def _size_arguments(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--width", type=positive, metavar="W", help=f"pixels [{default}]")
    parser.add_argument("--height", type=positive, metavar="H", help="pixels, with --width")


if __name__ == "__main__":
    sys.exit(main())
