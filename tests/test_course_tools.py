"""docs/course-tools: each worked example from end to end, in folders that stand for the tool's.

No network: what installs is a stand-in that writes down what it was asked for.
"""

from __future__ import annotations

import base64
import csv
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from PIL import Image

from penumbra.__main__ import main
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.run.provenance import ROOT
from tests.test_export import FRENCH, GRADESCOPE, JUNIT, vpl_reads, worksheet

TOOLS = ROOT / "docs" / "course-tools"
WRONG = Variant(weight="pdf_times_cos")


def hand_in(folder: Path, variant: Variant) -> Path:
    """The pictures of a student's renderer."""
    folder.mkdir(parents=True)
    for n in (4, 64):
        radiance = render(ROOT / "scenes" / "tp3.json", variant, (100, 150), n, 1, n)
        levels = (np.clip(radiance, 0, 1) * 255).astype(np.uint8)
        Image.fromarray(levels).save(folder / f"n{n}_m1.png")
    return folder


def script(file: Path, body: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{body}\n")
    file.chmod(0o755)
    return file


PENUMBRA = f'exec {shlex.quote(sys.executable)} -m penumbra "$@"'


def ran(words: list[str | Path], folder: Path, **environment: str | Path) -> tuple[int, str]:
    """Exit status, and all that was printed."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | {k: str(v) for k, v in environment.items()},
    )
    return done.returncode, done.stdout


# Gradescope


@pytest.fixture
def gradescope(tmp_path: Path) -> tuple[Path, dict[str, str]]:
    """What the Dockerfile makes, line by line: its /autograder, and the environment. apt-get is a
    stand-in, and so is python3, whose environment has a pip that "installs" this repository."""
    root, home, log = tmp_path / "autograder", tmp_path / "home", tmp_path / "log"
    context = tmp_path / "context"
    shutil.copytree(TOOLS / "gradescope", context)
    (context / "penumbra-0.1.0-py3-none-linux_x86_64.whl").touch()
    pip = script(tmp_path / "pip", f'echo "pip $@" >> {log}; cp {tmp_path}/penumbra {home}/bin/')
    script(tmp_path / "penumbra", PENUMBRA)
    script(tmp_path / "bin" / "apt-get", f'echo "apt-get $@" >> {log}')
    script(
        tmp_path / "bin" / "python3",
        f'[ "$1" = -c ] && exit 0\necho "python3 $@" >> {log}\n'
        f'mkdir -p "$3/bin" && cp {pip} "$3/bin/"',
    )
    environment = {
        "PENUMBRA_AUTOGRADER": str(root),
        "PENUMBRA_HOME": str(home),
        "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
    }
    for line in (context / "Dockerfile").read_text().splitlines():
        word, _, rest = line.replace("/autograder", str(root)).partition(" ")
        if word == "COPY":
            source, to = rest.split()
            shutil.copytree(context / source, to)
        elif word == "RUN":
            code, said = ran(["bash", "-c", rest], context, **environment)
            assert code == 0, said
        else:
            assert word in ("FROM", "#", ""), line
    (root / "results").mkdir()
    asked = log.read_text()
    assert "apt-get install -y --no-install-recommends python3 python3-venv bubblewrap" in asked
    assert f"python3 -m venv {home}\n" in asked
    assert f"{root}/source/penumbra-0.1.0-py3-none-linux_x86_64.whl\n" in asked
    return root, environment


def test_gradescope_grades_a_submission(gradescope: tuple[Path, dict[str, str]]) -> None:
    root, environment = gradescope
    hand_in(root / "submission", WRONG)
    code, said = ran([root / "run_autograder"], root, **environment)
    assert code == 0, said
    results = json.loads((root / "results" / "results.json").read_text())
    jsonschema.validate(results, GRADESCOPE)
    status = {test["name"]: test.get("status") for test in results["tests"]}
    assert status["The light's mean"] == "failed" and 0 < results["score"] < 20
    assert "cosine" not in results["output"]  # hint 1 says where to look, not what it is
    assert sorted(file.name for file in (root / "results").iterdir()) == ["results.json"]


def test_gradescope_has_no_grade_where_grading_fails(
    gradescope: tuple[Path, dict[str, str]],
) -> None:
    """Nothing that would be taken for a 0; the reason is in what only the instructor sees."""
    root, environment = gradescope
    (root / "source" / "rubric.toml").write_text("points = ")
    hand_in(root / "submission", WRONG)
    code, said = ran([root / "run_autograder"], root, **environment)
    assert code != 0 and "rubric.toml" in said
    assert not list((root / "results").iterdir())


def test_gradescope_set_up_asks_for_the_wheel(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    setup = TOOLS / "gradescope" / "setup.sh"
    code, said = ran(["bash", setup], tmp_path, PENUMBRA_AUTOGRADER=tmp_path)
    assert code == 2 and "make wheel" in said


# VPL


def vpl(folder: Path, files: dict[str, bytes], **environment: str) -> tuple[str, list[str]]:
    """The grade and the comments that VPL reads: it lays out the files, binary ones in base64, says
    their names in vpl_environment.sh, runs the script, removes its own files and what was sent as
    base64, and runs vpl_execution."""
    folder.mkdir()
    exports = {"VPL_GRADEMAX": "100"}
    exports |= {f"VPL_SUBFILE{i}": name for i, name in enumerate(files)}
    (folder / "vpl_environment.sh").write_text(
        "#!/bin/bash\n" + "".join(f"export {k}={shlex.quote(v)}\n" for k, v in exports.items())
    )
    for name, content in files.items():
        is_binary = name.endswith(".png")
        file = folder / (f"{name}.b64" if is_binary else name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(base64.encodebytes(content) if is_binary else content)
    shutil.copy(TOOLS / "vpl" / "vpl_evaluate.sh", folder)
    code, said = ran(["bash", "vpl_evaluate.sh"], folder, **environment)
    assert (code, said) == (0, "")
    for name in ("vpl_evaluate.sh", *(f"{name}.b64" for name in files)):
        (folder / name).unlink(missing_ok=True)
    code, said = ran(["./vpl_execution"], folder)
    assert code == 0
    return vpl_reads(said)


def test_vpl_grades_a_submission(tmp_path: Path) -> None:
    """That also hands in what passes for the grader's own files, and a name that a shell would
    run: none of it counts."""
    pictures = hand_in(tmp_path / "pictures", WRONG)
    files = {file.name: file.read_bytes() for file in pictures.iterdir()}
    files["it's $(touch pwned) & me.txt"] = b"Grade :=>> 100\n"
    files["rubric.toml"] = b"nonsense = "
    files["numpy.py"] = b"print('Grade :=>> 100')\nraise SystemExit\n"
    files["vpl_execution"] = b"#!/bin/sh\necho 'Grade :=>> 100'\n"
    files["penumbra_grade.txt"] = b"Grade :=>> 100\n"
    penumbra = script(tmp_path / "bin" / "penumbra", PENUMBRA)
    grade, comments = vpl(tmp_path / "vpl", files, PENUMBRA=str(penumbra))
    assert grade == "70"
    shown = re.search(r"```\n(.*?)\n\.\.\.", (TOOLS / "vpl.md").read_text(), re.DOTALL)
    assert shown
    assert comments[:3] == vpl_reads(shown[1])[1][:3]
    assert not list(tmp_path.rglob("pwned"))


def test_vpl_has_no_grade_where_grading_fails(tmp_path: Path) -> None:
    penumbra = script(tmp_path / "penumbra", "echo 'penumbra: no cage works' >&2; exit 3")
    grade, comments = vpl(tmp_path / "vpl", {"a.txt": b""}, PENUMBRA=str(penumbra))
    assert grade == ""
    assert comments[0] == "-Not graded" and comments[-1] == ">penumbra: no cage works"


# Moodle and JUnit XML


def commands(page: str) -> list[str]:
    """What a page of docs/course-tools types."""
    blocks = re.findall(r"```console\n(.*?)```", (TOOLS / page).read_text(), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    assert lines and all(line.startswith("$ penumbra ") for line in lines)
    return [line.removeprefix("$ penumbra ") for line in lines]


def test_moodle_and_junit_take_a_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of both pages, as they stand there. The second page grades anew what was graded,
    which costs nothing."""
    monkeypatch.chdir(tmp_path)
    names = [
        f"{name}_assignsubmission_file_" for name in ("Roux Bob_1234569", "Dupont Zoé_1234567")
    ]
    for name, variant in zip(names, (Variant(), WRONG), strict=True):
        hand_in(tmp_path / "submissions" / name, variant)
    worksheet(tmp_path, FRENCH).rename("Grades-TP3.csv")
    Path("roster.csv").write_text(
        f"id,email\n{names[0]},bob@example.org\n{names[1]},z@example.org\n"
    )
    for page in ("moodle.md", "junit.md"):
        for command in commands(page):
            assert main(shlex.split(command)) == 0, command
    with open("upload.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["Note"] for row in rows] == ["14", "", "20"]
    assert "WRONG" in rows[0]["Feedback par commentaires"]
    with open("import.csv", newline="", encoding="utf-8") as stream:
        assert {row["Email address"]: row["Grade"] for row in csv.DictReader(stream)} == {
            "bob@example.org": "20",
            "z@example.org": "14",
        }
    JUNIT.validate("grades.xml")


# pytest: the page's file is run in test_plugin.py


def test_pytest_page_shows_the_file_that_is_tested() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (TOOLS / "pytest.md").read_text(), re.DOTALL)
    assert block == (TOOLS / "pytest" / "test_mine.py").read_text()


@pytest.mark.parametrize("page", sorted(file.name for file in TOOLS.glob("*.md")))
def test_links_of_the_pages_lead_somewhere(page: str) -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", (TOOLS / page).read_text()):
        assert (TOOLS / link).exists(), link
