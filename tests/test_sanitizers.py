"""The C code under ASan + UBSan, valgrind, and ThreadSanitizer with Archer: no report."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.test_scene_contract import INVALID, VALID

ARCHER = sorted(Path("/usr/lib").glob("llvm-*/lib/libarcher.so"))


@pytest.fixture(scope="session")
def checked() -> dict[str, Path]:
    """The program built for each checker, by `make`."""
    programs = {name: ROOT / "build" / name / "bin/penumbra-render"
                for name in ("asan", "tsan", "plain")}  # fmt: skip
    for name, program in programs.items():
        assert program.exists(), f"run `make build/{name}/bin/penumbra-render`"
    return programs


SMALL = ["--width", "31", "--height", "21", "--light-samples", "5"]


@pytest.mark.parametrize("scene", ["tp3", "tp3_statement", "tp3_point"])
@pytest.mark.parametrize("pixel_samples", ["1", "2"])
def test_no_address_or_undefined_behaviour_error_in_a_render(
    scene: str, pixel_samples: str, checked: dict[str, Path], scenes: Path, tmp_path: Path
) -> None:
    run = subprocess.run(
        [str(checked["asan"]), str(scenes / f"{scene}.json"), "-o", str(tmp_path / "a.exr"), *SMALL,
         "--pixel-samples", pixel_samples],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")


def test_no_address_or_undefined_behaviour_error_in_the_scene_reader(
    checked: dict[str, Path], tmp_path: Path
) -> None:
    """Every valid and invalid scene of the contract, leaks included."""
    contents = [(0, text) for text in VALID.values()]
    contents += [(2, text) for text, _, _ in INVALID.values()]
    file = tmp_path / "scene.json"
    for code, content in contents:
        file.write_bytes(content.encode() if isinstance(content, str) else content)
        run = subprocess.run(
            [str(checked["asan"]), "--print-scene", str(file)], capture_output=True, timeout=60
        )
        assert run.returncode == code, run.stderr.decode()
        assert b"Sanitizer" not in run.stderr and b"runtime error" not in run.stderr


@pytest.mark.parametrize("output", ["/nowhere/a.exr", None])
def test_valgrind_finds_no_error_and_no_leak(
    output: str | None, checked: dict[str, Path], scenes: Path, tmp_path: Path
) -> None:
    """One render, and one that cannot write its image. OpenMP's own pool of threads counts as
    "possibly lost" and is not ours."""
    run = subprocess.run(
        ["valgrind", "--quiet", "--error-exitcode=99", "--leak-check=full",
         "--errors-for-leak-kinds=definite", "--show-leak-kinds=definite",
         str(checked["plain"]), str(scenes / "tp3.json"),
         "-o", output or str(tmp_path / "a.exr"), *SMALL],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert run.returncode == (2 if output else 0), run.stderr
    assert "==" not in run.stderr


def run_with_archer(program: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    assert ARCHER, "libarcher.so is missing: apt install libomp-dev"
    environment = {
        **os.environ,
        "OMP_TOOL_LIBRARIES": str(ARCHER[-1]),
        "TSAN_OPTIONS": "ignore_noninstrumented_modules=1",
        "ARCHER_OPTIONS": "verbose=1",
    }
    return subprocess.run(
        [str(program), *arguments], capture_output=True, text=True, timeout=300, env=environment
    )


def test_threads_do_not_race(checked: dict[str, Path], scenes: Path, tmp_path: Path) -> None:
    run = run_with_archer(
        checked["tsan"], str(scenes / "tp3.json"), "-o", str(tmp_path / "a.exr"), *SMALL,
        "--threads", "4", "--pixel-samples", "2",
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert "Archer detected OpenMP application with TSan" in run.stdout + run.stderr
    assert "WARNING: ThreadSanitizer" not in run.stderr


def test_archer_finds_the_labs_race(tmp_path: Path) -> None:
    """The check above can fail: the lab's one static generator, shared by all threads."""
    source = tmp_path / "race.c"
    source.write_text(
        "#include <stdio.h>\n"
        "static unsigned state = 1;\n"
        "static unsigned random_number(void) { return state = state * 1664525u + 1u; }\n"
        "int main(void)\n{\n    unsigned sum = 0;\n"
        "#pragma omp parallel for reduction(+ : sum) num_threads(4)\n"
        "    for (int i = 0; i < 1000; i++)\n        sum += random_number();\n"
        '    printf("%u\\n", sum);\n    return 0;\n}\n'
    )
    program = tmp_path / "race"
    subprocess.run(
        ["clang", "-g", "-fopenmp", "-fsanitize=thread", str(source), "-o", str(program)],
        check=True,
    )
    assert "WARNING: ThreadSanitizer: data race" in run_with_archer(program).stderr
