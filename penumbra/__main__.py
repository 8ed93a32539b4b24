"""The command line: the one place that knows all the parts.

Each subcommand imports what it needs when it runs, since some parts take seconds to load and
others may not be installed.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence

from penumbra.cli import (
    calibrate,
    check,
    compare,
    converge,
    course,
    exact,
    export,
    grade,
    png,
    profile,
    reference,
    report,
    scene,
    self_shadow,
    speedup,
    stability,
    trade,
)
from penumbra.cli.arguments import help_format
from penumbra.cli.exit import EXTRA_OF, MISSING, SIGNALLED, USAGE, UsageError
from penumbra.compare.run.provenance import VERSION, how_to_install
from penumbra.language import LANGUAGES, of_environment, speaking

SUBCOMMANDS = (
    *(scene, reference, exact, compare, check, grade, export, calibrate, png),
    *(converge, speedup, trade, profile, stability, self_shadow, report, course),
)
"""In the order of the help"""


class _Stopped(KeyboardInterrupt):
    """By a signal. A KeyboardInterrupt itself that comes while a string is run, as where a
    dataclass is made, is remembered by `python -m`, which then dies of SIGINT in the end."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand; its exit code. Errors meant for the user are one sentence on stderr.

    Without arguments those of the process are meant, which ends afterwards: SIGINT and SIGTERM
    no longer change its exit status then.
    """
    with speaking(_language(arguments)):
        return _run(arguments)


def _language(arguments: Sequence[str] | None) -> str:
    """What --lang says, else the environment: known before the first word is said."""
    early = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    early.add_argument("--lang", nargs="?")
    asked = early.parse_known_args(arguments)[0].lang
    return asked if asked in LANGUAGES else of_environment()


def _run(arguments: Sequence[str] | None) -> int:
    if sys.stdout is None:  # closed, by `>&-`: what is printed then fails, rather than vanish
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
    stopped_by: list[int] = []

    def stop(number: int, frame: object) -> None:
        stopped_by.append(number)
        raise _Stopped

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
    if isinstance(error, ModuleNotFoundError) and error.name in EXTRA_OF:
        return f"{error.name} is not installed: {how_to_install(EXTRA_OF[error.name])}"
    return str(error)


def _exit_code(error: BaseException) -> int | None:
    """Our own exceptions, and the system's about files, say all; others are our bugs: None."""
    if isinstance(error, ImportError):  # a library, or bpy: MissingBlender is one
        return MISSING
    if isinstance(error, UsageError | OSError):
        return USAGE
    if type(error).__module__.startswith("penumbra."):
        return int(getattr(error, "exit_code", USAGE))
    return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="penumbra",
        description="Soft shadows: renders compared with Cycles and with the exact answer.",
        epilog="exit status: 0 done, 1 a check failed, 2 usage, bad input or unwritable output, "
        "3 something is not installed or not built, 4 a check cannot tell,\n"
        "128 + n ended by signal n (130 is Ctrl-C).\n"
        "`penumbra SUBCOMMAND --help` explains each with an example.",
        formatter_class=help_format,
    )
    parser.add_argument("--version", action="version", version=f"penumbra {VERSION}")
    subcommands = parser.add_subparsers(required=True, metavar="SUBCOMMAND")
    for subcommand in SUBCOMMANDS:
        subcommand.add(subcommands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
