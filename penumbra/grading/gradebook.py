"""A class's submissions, judged in parallel, and its grades: grades.json and grades.csv."""

from __future__ import annotations

import csv
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import penumbra
from penumbra.compare.check.catalogue import FILE
from penumbra.compare.check.explanation import title
from penumbra.compare.check.mistaken import LIBRARY
from penumbra.compare.run.journal import Journal
from penumbra.compare.run.output import write_json, write_whole
from penumbra.compare.run.provenance import VERSION, file_hash
from penumbra.compare.run.tasks import Lost, Scheduler, Task, content_key, run_tasks
from penumbra.grading.claims import THREADS, UNTOLD, State, timed
from penumbra.grading.grade import Options, judge, lost
from penumbra.grading.rubric import Rubric, for_instructor
from penumbra.grading.submission import Entry, read
from penumbra.grading.timing import time_threads
from penumbra.language import _

SCHEMA = "penumbra-grades/1"
JOURNAL, GRADES, TABLE = "grades.journal", "grades.json", "grades.csv"
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a spreadsheet takes for the beginning of a formula"""
PASSING = ("internal", "killed_worker")
"""Problems that may be gone when a submission is judged again"""
Progress = Callable[[int, int], None]
"""Told how many of how many submissions are judged"""


@dataclass(frozen=True)
class Class:
    """What is asked of a class."""

    options: Options
    rubric: Rubric
    hint: int
    """0 to 3: how much students are told"""
    time_threads: bool = False
    """programs are timed, one after another, once all are judged"""


def grade_class(
    entries: Sequence[Entry],
    asked: Class,
    out: Path,
    scheduler: Scheduler | None = None,
    jobs: int | None = None,
    progress: Progress = lambda done, of: None,
) -> dict[str, Any]:
    """Judge every submission and write OUT/grades.json and OUT/grades.csv; the grades.

    What is judged is kept in OUT/grades.journal at once: a stopped run goes on where it was, and
    another rubric or hint judges nothing again. Raises JournalError, OSError, MissingProgramError,
    MissingCageError, SchedulerError, MissingWorkersError.
    """
    with Journal(out / JOURNAL) as journal:
        keys, passing = _judge_all(entries, asked.options, journal, scheduler, jobs, progress)

        def judged(key: str) -> Any:
            return passing.get(key) or journal.get(key)

        timings = _time_all(entries, keys, judged, asked, journal)
        grades = _grades(keys, judged, timings, asked)
    write_json(out / GRADES, grades)
    write_table(out / TABLE, grades)
    return grades


def code_version() -> str:
    """Changes with whatever decides what is said of a submission."""
    folder = Path(penumbra.__file__).parent
    sources = [*folder.glob("compare/**/*.py"), *folder.glob("grading/*.py"), FILE]
    sources += [folder / "language.py", *folder.glob("locale/*/*/*.mo")]
    return file_hash(*sorted(sources), *([LIBRARY] if LIBRARY.is_file() else []))


def _judge_all(
    entries: Sequence[Entry],
    options: Options,
    journal: Journal,
    scheduler: Scheduler | None,
    jobs: int | None,
    progress: Progress,
) -> tuple[dict[str, str], dict[str, Any]]:
    """The journal's key of each submission, by its id; and by its key what was said of those that
    failed through a fault of ours, or with the process that worked on them, which are judged again
    in the next run. Submissions of the same bytes are judged once."""
    version = code_version()
    keys: dict[str, str] = {}
    passing: dict[str, Any] = {}
    asked: set[str] = set()
    judged = 0

    def tasks() -> Iterator[Task]:
        nonlocal judged
        for entry in entries:  # one after another: a class may not fit into memory
            content = read(entry.path)
            key = keys[entry.id] = content_key(version, options.key, content.key)
            if journal.get(key) is not None or key in asked:
                judged += 1
                progress(judged, len(entries))
                continue
            asked.add(key)
            yield Task(key, (content, options))

    alone = scheduler is None and len(entries) == 1
    results = _alone(tasks()) if alone else run_tasks(judge, tasks(), scheduler, jobs)
    for task, found in results:
        said = lost(found.reason) if isinstance(found, Lost) else found
        if (said["problem"] or {}).get("code") in PASSING:
            passing[task.key] = said
        else:
            journal.append(task.key, said)
        judged += 1
        progress(judged, len(entries))
    return keys, passing


def _alone(tasks: Iterable[Task]) -> Iterator[tuple[Task, Any]]:
    """One submission, as an autograder has, needs no cluster: a process, so that this one outlives
    whatever becomes of it. Raises what judge raises."""
    context = get_context("spawn")
    for task in tasks:
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(sender, task.argument))
        process.start()
        sender.close()
        try:
            found = receiver.recv()
        except EOFError:
            found = Lost(_("it ended without an answer"))
        finally:
            process.kill()
            process.join()
        if isinstance(found, BaseException):
            raise found
        yield task, found


def _work(sender: Any, argument: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group
    try:
        found: Any = judge(argument)
    except Exception as error:
        found = error
    sender.send(found)


def _time_all(
    entries: Sequence[Entry],
    keys: Mapping[str, str],
    judged: Callable[[str], Any],
    asked: Class,
    journal: Journal,
) -> dict[str, Any]:
    """What time_threads says, by the keys of the programs whose threads do no harm."""
    found: dict[str, Any] = {}
    for entry in entries if asked.time_threads else ():
        key = keys[entry.id]
        said = judged(key)
        if said["kind"] != "program" or said["states"].get(THREADS, {}).get("state") != UNTOLD:
            continue
        if (timing := journal.get(timed_key := content_key(key, "threads"))) is None:
            timing = time_threads(read(entry.path), asked.options)
            journal.append(timed_key, timing)
        found[key] = timing
    return found


def _grades(
    keys: Mapping[str, str],
    judged: Callable[[str], Any],
    timings: Mapping[str, Any],
    asked: Class,
) -> dict[str, Any]:
    alike: dict[str, list[str]] = {}
    for id_, key in sorted(keys.items()):
        if judged(key)["status"] == "graded":  # nothing is the same as nothing
            alike.setdefault(key, []).append(id_)
    submissions = [
        _entry(id_, judged(key), timings.get(key), asked, _others(alike.get(key, []), id_))
        for id_, key in sorted(keys.items())
    ]
    return {
        "schema": SCHEMA,
        "scene": Path(asked.options.scene).stem,
        "hint": asked.hint,
        "language": asked.options.language,
        "trusted": asked.options.trusted,
        "rubric": asked.rubric.json(),
        "submissions": submissions,
        "mistakes": _ranked(submissions),
        "versions": {"penumbra": VERSION},
    }


def _others(ids: Iterable[str], one: str) -> list[str]:
    return [other for other in ids if other != one]


def _entry(
    id_: str,
    judged: Mapping[str, Any],
    timing: Mapping[str, Any] | None,
    asked: Class,
    same_as: list[str],
) -> dict[str, Any]:
    """A submission's entry: what was judged, at the hint's level, in the rubric's points."""
    found = {
        claim: State(state["state"], tuple(state["why"]))
        for claim, state in judged["states"].items()
    }
    if timing:
        found[THREADS] = timed(timing)
    marks = asked.rubric.marks(found, asked.hint)
    first = ("kind", "status", "problem", "verdict", "confidence", "headline")
    lists = ("mistakes", "titles", "perhaps", "alike", "facts")
    return {
        "id": id_,
        **{key: judged[key] for key in first},
        "text": judged["texts"][asked.hint],
        **{key: judged[key] for key in lists},
        "points": sum(mark["points"] for mark in marks),
        "of": asked.rubric.total,
        "claims": marks,
        "for_instructor": for_instructor(marks),
        "same_as": same_as,
        "pictures": judged["pictures"],
        "evidence": judged["evidence"],
        "other_scenes": judged["other_scenes"],
    }


def _ranked(submissions: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Which mistakes the class makes, the commonest first."""
    made: dict[str, list[str]] = {}
    for submission in submissions:
        for name in submission["mistakes"]:
            made.setdefault(name, []).append(submission["id"])
    return [
        {"name": name, "title": title(name), "submissions": ids}
        for name, ids in sorted(made.items(), key=lambda item: (-len(item[1]), item[0]))
    ]


def write_table(file: Path, grades: Mapping[str, Any]) -> None:
    """A row a submission, for a spreadsheet: UTF-8 with the mark that Excel wants, without which it
    takes names for another encoding; no cell is a formula. Raises OSError."""
    claims = [claim["id"] for claim in grades["rubric"]["claims"]]
    head = ["submission", "status", "verdict", "points", "of", *claims]
    head += ["mistakes", "for_instructor", "same_as", "says"]

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8-sig") as stream:
            table = csv.writer(stream, lineterminator="\r\n")
            table.writerow(head)
            for one in grades["submissions"]:
                row = [
                    *(one["id"], one["status"], one["verdict"], one["points"], one["of"]),
                    *(mark["points"] for mark in one["claims"]),
                    *("; ".join(one[key]) for key in ("titles", "for_instructor", "same_as")),
                    one["headline"],
                ]  # fmt: skip
                table.writerow([cell(value) for value in row])

    write_whole(file, write)


def cell(value: object) -> object:
    """Harmless in a spreadsheet: what would be a formula is text.

    >>> cell("=1+1"), cell("dupont"), cell(-3)
    ("'=1+1", 'dupont', -3)
    """
    if isinstance(value, str) and value.startswith(FORMULA):
        return f"'{value}"
    return value
