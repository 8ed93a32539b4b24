"""penumbra grade: a class in, grades out, the same whoever worked on it and whatever died."""

from __future__ import annotations

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as PillowImage

from penumbra.__main__ import main
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.checking import Checker, check, verdict_json
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.specimens import Specimen
from penumbra.compare.run.provenance import ROOT, cores
from penumbra.compare.run.tasks import Lost, Task
from penumbra.grading import gradebook, submission, timing
from penumbra.grading.cage import Limits, MissingCageError
from penumbra.grading.grade import Options, PatternError, judge, pattern_of
from penumbra.grading.gradebook import Class, grade_class
from penumbra.grading.rubric import read_rubric
from penumbra.grading.submission import FolderError, entries, read, shown
from tests.classroom import HOSTILE, SMALL, Seat, broken, hostile, pictures, programs, seat

TP3 = ROOT / "scenes" / "tp3.json"
OPTIONS = Options("scenes/tp3.json", TP3.read_bytes())
ASKED = Class(OPTIONS, read_rubric(), 2)
RIGHT = Specimen("correct", "tp3", ("mistakes",), Variant(), SMALL, ((16, 1),), seed=5)


@pytest.fixture(scope="module")
def seats(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Seat]]:
    """Six with pictures, four of which make a mistake, and six with less."""
    folder = tmp_path_factory.mktemp("class") / "submissions"
    return folder, pictures(folder, 6) + broken(folder)


@pytest.fixture(scope="module")
def graded(
    seats: tuple[Path, list[Seat]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """By the command line, on two processes."""
    out = tmp_path_factory.mktemp("graded")
    assert main(["grade", str(seats[0]), "-o", str(out), "--jobs", "2", "--hint", "2"]) == 0
    return out, json.loads((out / "grades.json").read_text())


def here(function: Any, tasks: Any, *_: Any) -> Any:
    """run_tasks in this process."""
    for task in tasks:
        yield task, function(task.argument)


def by_id(grades: dict[str, Any]) -> dict[str, Any]:
    return {one["id"]: one for one in grades["submissions"]}


# ---------------------------------------------------------------- a class


def test_the_right_are_right_and_mistakes_are_named(
    seats: tuple[Path, list[Seat]], graded: tuple[Path, dict[str, Any]]
) -> None:
    found = by_id(graded[1])
    assert list(found) == sorted(seat.id for seat in seats[1])
    for one in seats[1]:
        said = found[one.id]
        if one.truth is None:
            assert said["status"] == "failed" and said["points"] == 0, said
            continue
        assert said["verdict"] == ("wrong" if one.truth else "right"), said
        assert tuple(said["mistakes"]) == one.truth
        assert said["points"] < 20 if one.truth else said["points"] == 20


def test_points_are_the_sum_of_the_claims(graded: tuple[Path, dict[str, Any]]) -> None:
    rubric = graded[1]["rubric"]
    assert rubric["total"] == 20 == sum(claim["points"] for claim in rubric["claims"])
    for one in graded[1]["submissions"]:
        assert one["points"] == sum(claim["points"] for claim in one["claims"])
        for claim in one["claims"]:
            lost = claim["state"] in ("refuted", "missing")
            assert claim["points"] == (0 if lost else claim["of"])
            assert claim["why"].endswith(".") and "\n" not in claim["why"]
            told = claim["state"] != "cannot tell"
            assert (claim["id"] in one["for_instructor"]) != told


@pytest.mark.parametrize(
    ("id_", "code", "said"),
    [
        ("broken_empty", "no_image", "there is none in it"),
        ("broken_text", "bad_image", "n16_m1.png: left out: cannot be read"),
        ("broken_truncated", "bad_image", "n16_m1.png: left out: cannot be read"),
        ("broken_tiny", "bad_image", "n16_m1.png: too small"),
        ("broken_link", "link", "links are not followed"),
    ],
)
def test_what_cannot_be_judged_is_said(
    graded: tuple[Path, dict[str, Any]], id_: str, code: str, said: str
) -> None:
    one = by_id(graded[1])[id_]
    assert one["problem"]["code"] == code
    assert said in one["problem"]["text"]
    assert {claim["state"] for claim in one["claims"]} == {"missing"}


def test_the_commonest_mistakes_come_first(
    seats: tuple[Path, list[Seat]], graded: tuple[Path, dict[str, Any]]
) -> None:
    made = {name: [s.id for s in seats[1] if s.truth == (name,)] for name in
            {s.truth[0] for s in seats[1] if s.truth}}  # fmt: skip
    listed = graded[1]["mistakes"]
    assert {m["name"]: m["submissions"] for m in listed} == made
    assert listed == sorted(listed, key=lambda m: (-len(m["submissions"]), m["name"]))


def test_grades_say_nothing_of_machine_paths_or_times(
    seats: tuple[Path, list[Seat]], graded: tuple[Path, dict[str, Any]]
) -> None:
    text = (graded[0] / "grades.json").read_text()
    for word in (str(seats[0]), str(ROOT), "/tmp", '"seconds"', '"machine"', '"origin"'):
        assert word not in text


def test_the_same_bytes_by_one_process_in_another_order(
    seats: tuple[Path, list[Seat]],
    graded: tuple[Path, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Here one process judges all, so that each finds other views kept than there."""
    monkeypatch.setattr(gradebook, "run_tasks", here)
    order = entries(seats[0])
    random.Random(3).shuffle(order)
    grade_class(order, ASKED, tmp_path)
    for name in ("grades.json", "grades.csv"):
        assert (tmp_path / name).read_bytes() == (graded[0] / name).read_bytes()


def test_another_rubric_or_hint_judges_nothing_again(
    seats: tuple[Path, list[Seat]],
    graded: tuple[Path, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    shutil.copytree(graded[0], out)

    def none(function: Any, tasks: Any, *_: Any) -> Any:
        assert list(tasks) == []
        return iter(())

    monkeypatch.setattr(gradebook, "run_tasks", none)
    rubric = tmp_path / "mine.toml"
    rubric.write_text("[points]\nlight_mean = 7\n")
    command = ["grade", str(seats[0]), "-o", str(out), "--rubric", str(rubric), "--hint", "0"]
    assert main(command) == 0
    again = json.loads((out / "grades.json").read_text())
    assert again["rubric"]["total"] == 7 and again["hint"] == 0
    for was, now in zip(graded[1]["submissions"], again["submissions"], strict=True):
        assert now["evidence"] == was["evidence"]
        assert now["text"].count("\n") == 1 or now["facts"]
        assert [claim["id"] for claim in now["claims"]] == ["light_mean"]


# ---------------------------------------------------------------- a run that dies


def test_a_killed_run_goes_on_and_judges_nothing_twice(
    seats: tuple[Path, list[Seat]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four of the class; SIGKILL to all processes of the run as soon as one is judged."""
    folder, out, whole = (tmp_path / name for name in ("class", "out", "whole"))
    for seated in seats[1][:4]:
        shutil.copytree(seats[0] / seated.id, folder / seated.id)
    command = [sys.executable, "-m", "penumbra", "grade", str(folder), "-o", str(out)]
    command += ["--jobs", "2", "--hint", "2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    journal = out / "grades.journal"
    with subprocess.Popen(
        command, env=environment, start_new_session=True, stderr=subprocess.DEVNULL
    ) as run:
        end = time.monotonic() + 300
        while not (journal.exists() and journal.read_bytes().count(b"\n") >= 1):
            assert run.poll() is None and time.monotonic() < end
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGKILL)
    assert not (out / "grades.json").exists()
    kept = journal.read_bytes()
    assert subprocess.run(command, env=environment, capture_output=True).returncode == 0
    assert journal.read_bytes().startswith(kept[: kept.rfind(b"\n") + 1])
    keys = [json.loads(line)["key"] for line in journal.read_bytes().splitlines()]
    assert len(keys) == len(set(keys)) == 4
    monkeypatch.setattr(gradebook, "run_tasks", here)
    grade_class(entries(folder), ASKED, whole)
    assert (out / "grades.json").read_bytes() == (whole / "grades.json").read_bytes()


def test_a_submission_that_kills_its_workers_fails_and_the_class_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dying(function: Any, tasks: Any, *_: Any) -> Any:
        for task in tasks:
            hurt = any(file.data == b"deadly" for file in task.argument[0].files)
            yield task, Lost("it died 3 times") if hurt else function(task.argument)

    monkeypatch.setattr(gradebook, "run_tasks", dying)
    for name, data in (("a", b"deadly"), ("b", b"text")):
        (tmp_path / "class" / name).mkdir(parents=True)
        (tmp_path / "class" / name / "n16_m1.png").write_bytes(data)
    a, b = grade_class(entries(tmp_path / "class"), ASKED, tmp_path / "out")["submissions"]
    assert a["problem"]["code"] == "killed_worker" and a["points"] == 0
    assert b["problem"]["code"] == "bad_image"
    assert (tmp_path / "out" / "grades.journal").read_bytes().count(b"\n") == 1  # a is tried again


def test_a_fault_of_ours_costs_no_points(
    seats: tuple[Path, list[Seat]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise IndexError("5 of 4")

    monkeypatch.setattr("penumbra.grading.grade._of_pictures", fails)
    said = judge((read(entries(seats[0])[-1].path), OPTIONS))
    assert said["problem"]["code"] == "internal" and "IndexError: 5 of 4" in said["headline"]
    assert {state["state"] for state in said["states"].values()} == {"cannot tell"}


# ---------------------------------------------------------------- what is shared


def test_what_a_checker_keeps_changes_nothing(tmp_path: Path, make_scene: Any) -> None:
    """A right picture, and one with a sphere of another colour, which a view takes up; of the same
    rays: each as by a checker of its own, before and after the other."""
    files, scenes = [], []
    for i, colour in enumerate(([0.2, 0.4, 0.8], [0.8, 0.4, 0.2])):
        sphere = {"name": "sphere", "center": [0, 0, 3], "radius": 1, "color": colour}
        scenes.append(make_scene(file_name=f"{i}.json", spheres=[sphere]))
        radiance = np.clip(render(scenes[i], Variant(), SMALL, 16, 1, 3), 0, 1)
        files.append(tmp_path / f"{i}_n16.png")
        PillowImage.fromarray((255 * radiance).astype(np.uint8)).save(files[i])
    alone = {file: verdict_json(check([file], scenes[0])) for file in files}
    assert any(code == "colours sphere" for code, _ in alone[files[1]]["facts"])
    checker = Checker()
    for file in (files[1], files[0], files[1], files[0]):
        assert verdict_json(check([file], scenes[0], checker=checker)) == alone[file]


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize(
    ("pattern", "name", "counts"),
    [
        ("n{light_samples}_m{pixel_samples}.png", "n016_m1", ("16", "1")),
        ("n{light_samples}_m{pixel_samples}.png", "N4_M16", ("4", "16")),
        ("n{light_samples}_m{pixel_samples}.png", "an4_m16", None),
        ("n{light_samples}_m{pixel_samples}.png", "n0_m16", None),
        ("*-{light_samples}.exr", "dupont-64", ("64", None)),
        ("{scene}/n{light_samples}", "tp3_disk/n64", ("64", None)),
    ],
)
def test_patterns_name_pictures(
    pattern: str, name: str, counts: tuple[str | None, str | None] | None
) -> None:
    match = pattern_of(pattern).fullmatch(name)
    found = match and {"pixel_samples": None, **match.groupdict()}
    assert (found and (found["light_samples"], found["pixel_samples"])) == counts


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("n{samples}.png", "{samples}: a pattern may have {light_samples}"),
        ("n{pixel_samples}.png", "without {light_samples} nobody knows N"),
        ("n{light_samples}_{light_samples}.png", "{light_samples} stands there twice"),
    ],
)
def test_a_wrong_pattern_is_refused(pattern: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(PatternError) as error:
        pattern_of(pattern)
    assert said in str(error.value)
    assert main(["grade", str(tmp_path), "-o", str(tmp_path / "o"), "--images", pattern]) == 2


def test_one_picture_a_name_and_the_unreadable_left_out(tmp_path: Path) -> None:
    """The float one of two; a text named .png costs nothing beside a good picture."""
    seat(tmp_path, "a", RIGHT)
    shutil.copy(tmp_path / "a" / "n16_m1.png", tmp_path / "a" / "n16_m1.jpg")
    (tmp_path / "a" / "n4_m1.png").write_text("no")
    said = judge((read(tmp_path / "a"), OPTIONS))
    assert said["verdict"] == "right" and [p["name"] for p in said["pictures"]] == ["n16_m1.png"]
    assert any(f.startswith("n16_m1.jpg is left out") for f in said["facts"])
    assert any(f.startswith("n4_m1.png: left out: cannot be read") for f in said["facts"])
    assert "n4_m1.png: left out" in said["texts"][0]


def test_other_names_that_say_n_are_read_where_none_is_as_asked(tmp_path: Path) -> None:
    seat(tmp_path, "a", RIGHT, "tp3 N={n} aa0{m}")
    found = judge((read(tmp_path / "a"), OPTIONS))
    assert found["pictures"][0]["name"] == "tp3 N=16 aa01.png"
    assert found["pictures"][0]["light_samples"] == 16


def test_pictures_of_another_scene_are_judged_by_it(tmp_path: Path) -> None:
    """Lights that are averaged show where there are two; the rest of the claims stand."""
    two = Variant(lights="averaged_over_lights")
    seat(tmp_path / "a", "tp3", RIGHT)
    seat(tmp_path / "a", "tp3_two_quads", Specimen(
        "single", "tp3_two_quads", ("mistakes",), two, SMALL, ((16, 1),), seed=5))  # fmt: skip
    (tmp_path / "a" / "moon").mkdir()
    shutil.copy(tmp_path / "a/tp3/n16_m1.png", tmp_path / "a/moon")
    options = Options(
        "scenes/tp3.json", TP3.read_bytes(), "{scene}/n{light_samples}_m{pixel_samples}.png"
    )
    said = judge((read(tmp_path / "a"), options))
    assert said["verdict"] == "wrong" and said["mistakes"] == ["averaged_over_lights"]
    assert said["evidence"]["verdict"] == "right"
    assert [one["scene"] for one in said["other_scenes"]] == ["tp3_two_quads"]
    states = {claim: state["state"] for claim, state in said["states"].items()}
    assert states["other_lights"] == "refuted" and states["light_mean"] == "shown"
    assert any("no scene is called moon" in fact for fact in said["facts"])


def test_a_scene_of_the_instructors_own(tmp_path: Path, make_scene: Any) -> None:
    """Of the same bytes as it was written, wherever it lies."""
    scene_file = make_scene(file_name="lab.json", background=[0.1, 0.2, 0.3])
    own = Options("lab.json", scene_file.read_bytes())
    seat(tmp_path, "a", RIGHT)
    said = judge((read(tmp_path / "a"), own))
    assert said["verdict"] == "right"
    assert "lab.json" in said["evidence"]["command"]
    assert any("background" in fact for fact in said["facts"])


# ---------------------------------------------------------------- folders


NAMES = ("=1+1", "-n", "a\nb", "..c", "Zoé <b>", "\u202egnp", "é\udcff", "a\\nb")


def test_hostile_names_stay_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradebook, "run_tasks", here)
    for name in NAMES:
        (tmp_path / "class" / name).mkdir(parents=True)
    found = entries(tmp_path / "class")
    assert len({entry.id for entry in found}) == len(NAMES) - 1  # what starts with a dot is none
    for entry in found:
        assert entry.id.isprintable()
        entry.id.encode()
    assert shown("a\nb") != shown("a\\nb")
    out = tmp_path / "out"
    assert main(["grade", str(tmp_path / "class"), "-o", str(out)]) == 0
    with (out / "grades.csv").open(encoding="utf-8-sig", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(found)
    for row in rows:
        assert all(not cell.startswith(("=", "+", "-", "@", "\t", "\r")) for cell in row.values())
    assert "'=1+1" in {row["submission"] for row in rows}


def test_the_table_opens_in_a_spreadsheet(graded: tuple[Path, dict[str, Any]]) -> None:
    """UTF-8 said by its mark, lines as RFC 4180 wants them, a row a submission."""
    data = (graded[0] / "grades.csv").read_bytes()
    assert data.startswith(b"\xef\xbb\xbf") and data.count(b"\r\n") == data.count(b"\n")
    rows = list(csv.DictReader(data.decode("utf-8-sig").splitlines()))
    for row, one in zip(rows, graded[1]["submissions"], strict=True):
        assert (row["submission"], int(row["points"])) == (one["id"], one["points"])
        assert sum(int(row[claim["id"]]) for claim in one["claims"]) == one["points"]


def test_links_inside_a_submission_are_not_followed(tmp_path: Path) -> None:
    seat(tmp_path, "other", RIGHT)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "n16_m1.png").symlink_to(tmp_path / "other" / "n16_m1.png")
    os.mkfifo(tmp_path / "mine" / "n4_m1.png")
    content = read(tmp_path / "mine")
    assert content.files == () and content.links == ("n16_m1.png",)
    said = judge((content, OPTIONS))
    assert said["problem"]["code"] == "no_image" and "not followed" in said["problem"]["text"]


def test_results_in_the_folder_are_no_submission(tmp_path: Path) -> None:
    for name in ("dupont", "graded", ".git"):
        (tmp_path / name).mkdir()
    assert [e.id for e in entries(tmp_path, leave=[tmp_path / "graded"])] == ["dupont"]


def test_one_is_the_folder_itself_and_needs_no_cluster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(gradebook, "run_tasks", None)
    seat(tmp_path, "submission", RIGHT)
    command = ["grade", str(tmp_path / "submission"), "-o", str(tmp_path / "out"), "--one"]
    assert main(command) == 0
    assert "1 submissions: 1 right" in capsys.readouterr().out
    grades = json.loads((tmp_path / "out" / "grades.json").read_text())
    assert [one["id"] for one in grades["submissions"]] == ["submission"]
    assert (tmp_path / "out" / "index.html").exists()


def test_too_much_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(submission, "MOST_BYTES", 1000)
    monkeypatch.setattr(submission, "MOST_FILES", 3)
    (tmp_path / "large").mkdir()
    (tmp_path / "large" / "n16_m1.png").write_bytes(b"x" * 1001)
    (tmp_path / "many").mkdir()
    for i in range(4):
        (tmp_path / "many" / f"n{i}.png").touch()
    for name in ("large", "many"):
        assert read(tmp_path / name).problem is not None
        assert judge((read(tmp_path / name), OPTIONS))["problem"]["code"] == "too_large"


def test_the_same_bytes_are_judged_once_and_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seat(tmp_path / "class", "a", RIGHT)
    shutil.copytree(tmp_path / "class" / "a", tmp_path / "class" / "b")
    asked: list[Task] = []

    def counted(function: Any, tasks: Any, *_: Any) -> Any:
        for task in tasks:
            asked.append(task)
            yield task, function(task.argument)

    monkeypatch.setattr(gradebook, "run_tasks", counted)
    grades = grade_class(entries(tmp_path / "class"), ASKED, tmp_path / "out")
    assert len(asked) == 1
    assert [one["same_as"] for one in grades["submissions"]] == [["b"], ["a"]]


@pytest.mark.parametrize("kind", ["missing", "file", "empty"])
def test_a_folder_without_a_class_is_refused(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / kind
    if kind == "file":
        folder.touch()
    if kind == "empty":
        folder.mkdir()
    with pytest.raises(FolderError):
        entries(folder)
    assert main(["grade", str(folder), "-o", str(tmp_path / "out")]) == 2
    assert str(folder) in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_wrong_rubric_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "class" / "a").mkdir(parents=True)
    command = ["grade", str(tmp_path / "class"), "-o", str(tmp_path / "out")]
    assert main([*command, "--rubric", str(tmp_path / "no.toml")]) == 2
    assert not (tmp_path / "out").exists()


def test_thumbnails_are_small_jpegs(graded: tuple[Path, dict[str, Any]]) -> None:
    pictures = [p for one in graded[1]["submissions"] for p in one["pictures"]]
    assert pictures
    assert all(p["thumbnail"].startswith("data:image/jpeg;base64,") for p in pictures)
    assert np.mean([len(p["thumbnail"]) for p in pictures]) < 8000


# ---------------------------------------------------------------- programs


def test_a_program_is_built_run_and_graded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that overwrites what earlier lights brought, which only scenes of two lights show: by two
    pictures, of the lab's scene and of such a one. What is said of it holds no time."""
    monkeypatch.setattr("penumbra.grading.grade.ASKED_FOR", 2)
    made = next(one for one in programs(tmp_path, 8) if one.truth == ("only_one_light",))
    said = judge((read(tmp_path / made.id), OPTIONS))
    assert said["kind"] == "program" and said["mistakes"] == ["only_one_light"]
    states = {claim: state["state"] for claim, state in said["states"].items()}
    assert states.pop("threads") == "cannot tell"  # no clock was asked
    assert states.pop("other_lights") == "refuted"
    assert set(states.values()) == {"shown"}
    text = json.dumps(said)
    assert "seconds" not in text and "times as fast" not in text and str(tmp_path) not in text
    assert len(said["pictures"]) == 2


def test_a_program_is_timed_with_one_thread_and_with_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any ratio: the machine may be busy. One that cannot be built is said to be so."""
    monkeypatch.setattr(timing, "LONG_ENOUGH", 0.05)
    monkeypatch.setattr(timing, "ROUNDS", 1)
    home = tmp_path / programs(tmp_path, 1)[0].id
    found = timing.time_threads(read(home), OPTIONS)
    if cores() == 1:
        assert set(found) == {"problem"}
        return
    assert found["threads"] == min(cores(), OPTIONS.limits.processes // 2)
    assert 0 < found["ratio"] < 2 * found["threads"]
    (home / "mine.c").write_text("int main(void) { return nothing; }\n")
    assert "build" in timing.time_threads(read(home), OPTIONS)["problem"]


def test_times_change_one_claim_and_are_measured_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("penumbra.grading.grade.ASKED_FOR", 1)
    monkeypatch.setattr(gradebook, "run_tasks", here)
    monkeypatch.setattr(
        gradebook, "time_threads", lambda *_: asked.append(1) or {"threads": 2, "ratio": 1.8}
    )
    asked: list[int] = []
    programs(tmp_path / "class", 1)
    seat(tmp_path / "class", "pictures", RIGHT)
    found = entries(tmp_path / "class")
    timed = replace(ASKED, time_threads=True)
    every = [grade_class(found, who, tmp_path / "out") for who in (ASKED, timed, timed, ASKED)]
    assert asked == [1]
    states = [[c["state"] for c in by_id(g)["program000"]["claims"]] for g in every]
    assert states[0][4] == states[3][4] == "cannot tell" and states[1][4] == "shown"
    assert [one[:4] for one in states] == [states[0][:4]] * 4
    assert every[0] == every[3] and every[1] == every[2]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_program_is_said_to_be_what_it_is(tmp_path: Path, name: str) -> None:
    """tests/test_cage.py holds that it does no harm."""
    found = {one.id.partition("_")[2]: one for one in hostile(tmp_path)}[name]
    limits = Limits(seconds=3.0, memory=256 << 20, disk=16 << 20, file_size=8 << 20)
    said = judge((read(tmp_path / found.id), replace(OPTIONS, limits=limits)))
    assert said["kind"] == "program" and said["problem"]["code"] in found.codes
    assert {state["state"] for state in said["states"].values()} == {"missing"}
    assert said["problem"]["text"].endswith(".")


def test_a_build_that_fails_is_shown(tmp_path: Path) -> None:
    home = tmp_path / programs(tmp_path, 1)[0].id
    (home / "mine.c").write_text("int main(void) { return nothing; }\n")
    problem = judge((read(home), OPTIONS))["problem"]
    assert problem["code"] == "build_failed" and "nothing" in problem["printed"]


@pytest.mark.parametrize(
    ("files", "code", "said"),
    [
        ({"penumbra.toml": "[program]\nrin = 'x'\n"}, "manifest", "penumbra.toml:2: rin: unknown"),
        ({"a/penumbra.toml": "", "b/penumbra.toml": ""}, "manifest", "Hand in one program"),
        ({"a.zip": "no", "b.tar": "no"}, "archive", "Hand in one archive"),
        ({"a.zip": "no"}, "archive", "a.zip: "),
        ({"report.pdf": "%PDF", "main.c": ""}, "no_image", "there is none in it"),
        ({"final.png": "no"}, "no_image", "it holds final.png"),
    ],
)
def test_what_was_handed_in_instead_is_said(
    tmp_path: Path, files: dict[str, str], code: str, said: str
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    problem = judge((read(tmp_path), OPTIONS))["problem"]
    assert problem["code"] == code and said in problem["text"]


def test_an_archive_that_unpacks_outside_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as archive:
        archive.writestr("../../n16_m1.png", b"x")
    problem = judge((read(tmp_path), OPTIONS))["problem"]
    assert problem["code"] == "archive" and "leads out of the folder" in problem["text"]


def test_where_no_cage_works_programs_are_refused_and_pictures_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(trust: bool) -> None:
        raise MissingCageError("nothing here can hold it")

    monkeypatch.setattr("penumbra.grading.grade._cage", none)
    with pytest.raises(MissingCageError):
        judge((read(tmp_path / programs(tmp_path, 1)[0].id), OPTIONS))
    seat(tmp_path, "a", RIGHT)
    assert judge((read(tmp_path / "a"), OPTIONS))["verdict"] == "right"
