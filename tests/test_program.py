"""A submitted program: its penumbra.toml, its build, its pictures, and what is said of its faults.

The programs are C and Python, as students hand them in; test_cage.py has the hostile ones.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from penumbra.compare.check import program as check_program_module
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.program import SCENES, check_program
from penumbra.compare.run.renderers import Job, RendererError
from penumbra.grading.cage import Bubblewrap, Cage, Landlock, Limits, try_cage
from penumbra.grading.fault import SubmissionFault
from penumbra.grading.program import ManifestError, Program, read_manifest
from tests.conftest import ROOT

TP3 = ROOT / "scenes" / "tp3.json"
JOB = Job(TP3, 8, 6, 16, 1, seed=1, threads=2)
LIMITS = Limits(seconds=20, memory=256 << 20, processes=16, file_size=1 << 20, disk=8 << 20)
RUN = 'run = "./mine {scene} {light_samples} {seed} {out}"'
C_PROGRAM = """\
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
int main(int argc, char **argv) {
    char start[9] = {0};
    FILE *scene = fopen(argv[1], "r"), *out = fopen(argv[4], "w");
    if (argc != 5 || !scene || fread(start, 1, 1, scene) != 1 || start[0] != '{') return 3;
    fprintf(out, "N = %s, seed = %s, threads = %s", argv[2], argv[3], getenv("OMP_NUM_THREADS"));
    return fclose(out);
}
"""


@pytest.fixture(params=[c for c in (Bubblewrap(), Landlock()) if not try_cage(c)],
                ids=lambda cage: cage.name)  # fmt: skip
def cage(request: pytest.FixtureRequest) -> Cage:
    held: Cage = request.param
    return held


@pytest.fixture
def submission(tmp_path: Path) -> Callable[..., Path]:
    """A folder with these files, penumbra.toml among them."""

    def make(manifest: str = RUN, **files: str) -> Path:
        folder = tmp_path / "dupont"
        folder.mkdir(exist_ok=True)
        (folder / "penumbra.toml").write_text(f"[program]\n{manifest}\n")
        for name, text in files.items():
            (folder / name).write_text(text)
        return folder

    return make


def rendered(folder: Path, cage: Cage, limits: Limits = LIMITS, job: Job = JOB) -> bytes:
    """What the program makes in place of an image, having been built."""
    out = folder.parent / "image.exr"
    with Program(folder, read_manifest(folder), cage, limits) as program:
        program.build()
        assert program.renderer().run(job, out) > 0
    assert not program.desk.home.exists()
    return out.read_bytes()


def fault(folder: Path, cage: Cage, limits: Limits = LIMITS) -> SubmissionFault:
    with pytest.raises(SubmissionFault) as said:
        rendered(folder, cage, limits)
    assert str(folder) not in said.value.text and "/tmp/penumbra" not in said.value.text
    return said.value


# ---------------------------------------------------------------- the manifest


def test_a_manifest_says_how_to_build_and_run(submission: Callable[..., Path]) -> None:
    found = read_manifest(submission(f'{RUN}\nbuild = "make -s"\nimage_suffix = ".png"\n'
                                     'scenes = ["check_low", "tp3"]'))  # fmt: skip
    assert found.build == "make -s" and found.image_suffix == ".png"
    assert found.run.startswith("./mine") and found.scenes == ("tp3", "check_low")
    assert read_manifest(submission()).scenes == SCENES


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[program]\nrun = \n", "penumbra.toml: not TOML: .*line 2"),
        ("[programme]\n" + RUN, "penumbra.toml:1: programme: unknown"),
        ("run = 'x'", "penumbra.toml:1: run: unknown"),
        ("", "penumbra.toml: program: there must be a table"),
        ("program = 3", "penumbra.toml:1: program: there must be a table"),
        ("[program]\nbuild = 'make'", "penumbra.toml:1: program: has no run"),
        (f"[program]\n{RUN}\nbuidl = 'make'", "penumbra.toml:3: buidl: unknown: known are build"),
        (f"[program]\n{RUN}\n\nbuild = ['make']", "penumbra.toml:4: build: must be a text"),
        (f"[program]\n{RUN}\nbuild = '''a\nb'''", "penumbra.toml:3: build: must be one line"),
        ("[program]\nrun = './mine {scene} {seed} {out}'", ":2: run: .*no {light_samples}"),
        ("[program]\nrun = './mine {scene} {x}'", ":2: run: .*unknown placeholder {x}"),
        ("[program]\nrun = './mine \"{scene}'", ":2: run: .*No closing quotation"),
        (f"[program]\n{RUN}\nimage_suffix = '.tif'", ":3: image_suffix: must be one of .exr"),
        (f"[program]\n{RUN}\nscenes = ['tp4']", ":3: scenes: 'tp4': known are tp3"),
        (f"[program]\n{RUN}\nscenes = ['check_low']", ":3: scenes: tp3, the lab's own"),
        (f"[program]\n{RUN}\nscenes = [{'[' * 5000}", "more than 200 brackets"),
    ],
)
def test_an_error_in_a_manifest_names_line_and_key(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "penumbra.toml").write_text(text)
    with pytest.raises(ManifestError, match=said) as error:
        read_manifest(tmp_path)
    assert error.value.code == "manifest"
    assert pickle.loads(pickle.dumps(error.value)).text == error.value.text


def test_no_manifest_and_no_text_are_said(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="not there"):
        read_manifest(tmp_path)
    (tmp_path / "penumbra.toml").symlink_to("/etc/passwd")
    with pytest.raises(ManifestError, match="not there"):
        read_manifest(tmp_path)
    (tmp_path / "penumbra.toml").unlink()
    (tmp_path / "penumbra.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ManifestError, match="UTF-8"):
        read_manifest(tmp_path)


# ---------------------------------------------------------------- programs


def test_a_c_program_is_built_and_makes_its_image(
    cage: Cage, submission: Callable[..., Path]
) -> None:
    folder = submission(
        f'build = "make"\n{RUN}', **{"mine.c": C_PROGRAM, "Makefile": "mine: mine.c\n"}
    )
    assert rendered(folder, cage) == b"N = 16, seed = 1, threads = 2"
    assert not (folder / "mine").exists()


def test_a_python_program_needs_no_build(cage: Cage, submission: Callable[..., Path]) -> None:
    folder = submission(
        'run = "python3 mine.py --scene={scene} {light_samples} {seed} {out} {threads}"',
        **{"mine.py": "import sys; open(sys.argv[4], 'w').write(' '.join(sys.argv[2:4]))"},
    )
    assert rendered(folder, cage) == b"16 1"


def test_a_program_has_no_more_threads_than_processes(
    cage: Cage, submission: Callable[..., Path]
) -> None:
    folder = submission(
        'run = "sh mine {scene} {light_samples} {seed} {out} {threads}"',
        mine='echo "$5 $OMP_NUM_THREADS" > $4',
    )
    many = replace(JOB, threads=1000)
    assert rendered(folder, cage, replace(LIMITS, processes=10), many) == b"5 5\n"


def test_nothing_passes_from_one_run_to_the_next(
    cage: Cage, submission: Callable[..., Path], tmp_path: Path
) -> None:
    folder = submission(
        mine="#!/bin/sh\nls $TMPDIR > $4; touch $TMPDIR/left; touch left 2> $TMPDIR/x; cat x >> $4"
    )
    with Program(folder, read_manifest(folder), cage, LIMITS) as program:
        for seed in (1, 2):
            out = tmp_path / f"{seed}.exr"
            with pytest.raises(SubmissionFault):  # cat finds no x where it starts
                program.renderer().run(replace(JOB, seed=seed), out)
            assert [f.name for f in program.desk.tmp.iterdir() if f.name == "left"]
            assert not (program.desk.home / "left").exists()
            image = next(program.desk.tmp.glob("image*"))
            assert image.read_text().split() == [image.name]


@pytest.mark.parametrize(
    ("mine", "code", "said"),
    [
        ("exit 3", "crashed", "ended with exit code 3"),
        ("kill -SEGV $$", "crashed", "was ended by SIGSEGV: it reads or writes memory"),
        ("true", "no_image", "ended well but wrote no image"),
        ("ln -s /etc/passwd $4", "bad_image", "something else than a plain file"),
        ("while true; do :; done", "time_limit", "took longer than 1 s"),
        ("head -c 2000000 /dev/zero > $4", "file_limit", "a file of more than 1 MB"),
        ("yes", "output_limit", "printed more than 1.0 MB"),
        ("yes > /dev/null & " * 20 + "wait", "process_limit", "more than 16 processes"),
        ("for i in 1 2 3 4 5 6 7 8 9 10; do head -c 1000000 /dev/zero > $TMPDIR/$i; done",
         "disk_limit", "wrote more than 8 MB"),
        ("python3 -c 'x = bytearray(1 << 30)\nx[::4096] = b\"x\" * (1 << 18)'", "memory_limit",
         "took more than 256 MB"),
        ("exec python3 -c 'import socket; socket.socket()'", "forbidden", "a network connection"),
        ("echo; echo std::bad_alloc; exit 1", "memory_limit", "took more than 256 MB"),
    ],
    ids=lambda value: value if "_" in value or value.isalpha() else "",
)  # fmt: skip
def test_each_fault_has_a_code_and_a_sentence(
    mine: str, code: str, said: str, cage: Cage, submission: Callable[..., Path]
) -> None:
    limits = replace(LIMITS, seconds=1.0) if code == "time_limit" else LIMITS
    found = fault(submission(mine=f"#!/bin/sh\n{mine}\n"), cage, limits)
    assert found.code == code
    assert found.text.startswith("Rendering tp3 with 16 light samples, your program ")
    assert said in found.text


def test_a_program_that_is_not_there_is_said(cage: Cage, submission: Callable[..., Path]) -> None:
    found = fault(submission(), cage)
    assert found.code == "crashed" and "./mine could not be started" in found.text
    other = fault(submission(mine="neither script nor program"), cage)
    assert other.code == "crashed"


@pytest.mark.parametrize(
    ("build", "code", "said"),
    [
        ("make", "build_failed", "The build (make) ended with exit code 2: try it in a fresh copy"),
        ("sleep 100", "time_limit", "The build (sleep 100) took longer than 1 s"),
        ("yes | head -c 9999999 > x", "file_limit", "wrote a file of more than 1 MB"),
    ],
)
def test_a_build_that_fails_says_why(
    build: str, code: str, said: str, cage: Cage, submission: Callable[..., Path]
) -> None:
    limits = replace(LIMITS, seconds=1.0) if code == "time_limit" else LIMITS
    files = {"mine.c": "int main(void) { return x; }", "Makefile": "mine: mine.c\n"}
    found = fault(submission(f'build = "{build}"\n{RUN}', **files), cage, limits)
    assert found.code == code and said in found.text
    if code == "build_failed":
        assert "mine.c:1:25: error:" in found.printed


def test_what_is_printed_is_harmless_and_names_no_folder_of_ours(
    cage: Cage, submission: Callable[..., Path]
) -> None:
    found = fault(submission(mine="#!/bin/sh\npwd; echo $4; printf '\\033[31m'; exit 1"), cage)
    assert found.printed == "/submission\n/tmp/image.exr\n?[31m"


def test_links_are_not_handed_in(cage: Cage, submission: Callable[..., Path]) -> None:
    folder = submission(mine="#!/bin/sh\ncat reference > $4")
    (folder / "reference").symlink_to(TP3)
    found = fault(folder, cage)
    assert found.code == "archive" and "a link" in found.text


# ---------------------------------------------------------------- the check, without a clock


class Pretended:
    """A right program that claims to need any time."""

    suffix = ".png"
    placeholders = frozenset({"scene", "light_samples", "seed", "out", "pixel_samples"})

    def __init__(self, seconds: float) -> None:
        self.seconds, self.asked = seconds, list[tuple[str, int, int, int, int | None]]()

    def run(self, job: Job, out: Path) -> float:
        n, m = job.light_samples, job.pixel_samples
        self.asked.append((job.scene_file.stem, n, m, job.seed, job.threads))
        shape = job.height // 4, job.width // 4
        radiance = render(job.scene_file, Variant(), shape, n, m, job.seed)
        Image.fromarray((255 * np.clip(radiance, 0, 1)).astype(np.uint8)).save(out)
        return self.seconds

    def refused(self, job: Job, out: Path, why: str) -> RendererError:
        return RendererError(why)


def test_a_counted_check_asks_the_same_whatever_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fast program on a machine with one core, and a slow one on a machine with eight."""
    asked, facts, scores = [], [], []
    for seconds, cores in ((0.01, 1), (50.0, 8)):
        monkeypatch.setattr(check_program_module, "cores", lambda cores=cores: cores)
        subject = Pretended(seconds)
        found = check_program(subject, scenes=("tp3", "check_two_lights"), pictures=2)
        asked.append(subject.asked)
        facts.append(found.facts)
        scores.append(found.diagnosis.best)
        assert len(found.trials) == 2
    assert asked[0] == asked[1] and facts[0] == facts[1] and scores[0] == scores[1]
    assert [threads for *_, threads in asked[0]].count(1) == 1
    assert {threads for *_, threads in asked[0]} == {1, check_program_module.THREADS}


def test_a_picture_that_fails_counts_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(Pretended):
        def run(self, job: Job, out: Path) -> float:
            if job.scene_file.stem != "tp3":
                raise SubmissionFault("time_limit", "It took longer than 60 s")
            return super().run(job, out)

    found = check_program(Failing(0.1), scenes=("tp3", "check_two_lights", "check_low"), pictures=3)
    assert len(found.trials) + sum("fails" in name for name, _ in found.facts) == 3
    assert any("It took longer than 60 s" in text for _, text in found.facts)
