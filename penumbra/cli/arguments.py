"""Arguments: their types, and those that several subcommands take."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias
from urllib.parse import urlsplit

from penumbra.cli.exit import UsageError

if TYPE_CHECKING:
    from penumbra.compare.run.tasks import Scheduler

from penumbra.compare.run.provenance import ROOT
from penumbra.language import LANGUAGES, _, say

Subcommands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
IMAGE_FILES = ".exr, .pfm, .hdr, .png, .jpg or .bmp"
"""What is read as an image"""
SCENES = ROOT / "scenes"
SCENE_FILES = "scene file, or the name of one in scenes/"


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
            say('"{text}" is neither a list like 1,4,16 nor doublings like 1..4096', text=text)
        ) from None
    return tuple(counts)


def positive(text: str) -> int:
    value = int(text) if text.strip().isdecimal() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(
            say('"{text}" is not a whole number of 1 or more', text=text)
        )
    return value


def natural(text: str) -> int:
    return 0 if text.strip() == "0" else positive(text)


def seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(
            say('"{text}" is not a number of seconds above 0', text=text)
        )
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
        raise argparse.ArgumentTypeError(
            say('"{text}" is not a list of percentages like 3,1,0.3', text=text)
        )
    return tuple(values)


def scene_path(text: str) -> Path:
    """A file, or one of Penumbra's own scenes, which is found from everywhere: by its name or as
    the repository has it. What is neither is left to who reads it.

    >>> scene_path("tp3") == scene_path("scenes/tp3.json")
    True
    """
    if Path(text).exists():
        return Path(text)
    own = next((f for f in (SCENES / f"{text}.json", ROOT / text) if f.is_file()), Path(text))
    here = Path.cwd()
    return own.relative_to(here) if own.is_relative_to(here) else own


def help_format(prog: str) -> argparse.HelpFormatter:
    return argparse.RawDescriptionHelpFormatter(prog, max_help_position=28)


def add_subcommand(
    subcommands: Subcommands,
    name: str,
    run: Callable[[argparse.Namespace], int],
    text: str,
    example: str,
    kept: Callable[[argparse.Namespace], str] = lambda options: "",
) -> argparse.ArgumentParser:
    """The subcommand's parser, to add arguments to.

    run: does it; the exit code. kept: what to say of its results when it is stopped.
    """
    parser = subcommands.add_parser(
        name,
        help=text.partition(".")[0],
        description=text,
        epilog=f"example: {example}",
        formatter_class=help_format,
    )
    parser.set_defaults(run=run, kept=kept)
    return parser


def add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=scene_path, metavar="SCENE", help=SCENE_FILES)


def add_course(parser: argparse.ArgumentParser, default: str = "") -> None:
    parser.add_argument(
        "--course", metavar="ADDRESS",
        help="the course's page (make course), to whose museum of mistakes verdicts link: a URL, "
        f"file or folder [$PENUMBRA_COURSE{default}]",
    )  # fmt: skip


def course_of(options: argparse.Namespace) -> str:
    """The address of the course's page, as a URL; "" if there is none. Raises UsageError."""
    given = options.course if options.course is not None else os.environ.get("PENUMBRA_COURSE", "")
    scheme = urlsplit(given).scheme
    if not given or scheme in ("http", "https", "file"):
        return str(given).partition("#")[0]
    file = Path(given) / "index.html" if Path(given).is_dir() else Path(given)
    if not file.is_file():
        raise UsageError(
            say("course {given}: neither a URL (http, https, file) nor a page's file", given=given)
        )
    return file.resolve().as_uri()


def add_out(parser: argparse.ArgumentParser, metavar: str, parse: Callable[[str], Path]) -> None:
    parser.add_argument("-o", "--out", type=parse, required=True, metavar=metavar)


def add_cycles(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--cycles",
        nargs="?",
        type=sample_counts,
        const=sample_counts(default),
        metavar="N",
        help=f"Cycles too, with these numbers of samples [{default}]",
    )


def add_size(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--width", type=positive, metavar="W", help=f"pixels [{default}]")
    parser.add_argument("--height", type=positive, metavar="H", help="pixels, with --width")


def add_language(
    parser: argparse.ArgumentParser,
    default: str = "that of LANGUAGE, LC_ALL, LC_MESSAGES or LANG, else en",
) -> None:
    """--lang, which main() speaks in. default: as the help says it."""
    parser.add_argument("--lang", choices=LANGUAGES, help=f"language of what is said [{default}]")


def add_scheduler(parser: argparse.ArgumentParser, jobs: bool = True) -> None:
    """--scheduler and its keys; jobs: --jobs too."""
    if jobs:
        parser.add_argument(
            "--jobs", type=positive, metavar="J", help="processes on this machine [every core]"
        )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS|FILE",
        help="work on the workers of this Dask scheduler instead, tcp://host:8786 or the file of "
        "`dask scheduler --scheduler-file` (docs/scale.md)",
    )
    for name, what in (
        ("ca", "certificate of who signed the scheduler's and the workers'"),
        ("cert", "certificate to show them"),
        ("key", "key of --tls-cert"),
    ):
        parser.add_argument(
            f"--tls-{name}", type=Path, metavar="FILE.pem", help=f"with --scheduler tls://: {what}"
        )


def scheduler_of(options: argparse.Namespace) -> Scheduler | None:
    """What add_scheduler's options name. Raises UsageError, SchedulerError."""
    from penumbra.compare.run.tasks import Scheduler

    keys = (options.tls_ca, options.tls_cert, options.tls_key)
    if options.scheduler is None:
        if any(keys):
            raise UsageError(_("--tls-ca, --tls-cert and --tls-key go with --scheduler"))
        return None
    if getattr(options, "jobs", None):
        raise UsageError(_("--jobs is of this machine: leave it out with --scheduler"))
    return Scheduler(options.scheduler, *keys)
