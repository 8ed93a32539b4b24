"""The package: installed by pip in a bare environment, with no compiler, repository or network.

The libraries that it asks for, and those alone, are linked into the environment out of .venv: what
it needed beyond them would be missing here.
"""

from __future__ import annotations

import email
import importlib.metadata
import json
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from penumbra.cli.exit import EXTRA_OF
from penumbra.compare.run.provenance import VERSION
from tests.conftest import ROOT

PICTURES = ROOT / "docs" / "images" / "check"
SHARE = "penumbra/share/"
MADE = "build/lib/libmistakes.so"
"""What it brings along that is not as the repository has it: built for any processor"""


@pytest.fixture(scope="module")
def wheel() -> Path:
    found = sorted((ROOT / "build" / "wheel").glob("*.whl"))
    if len(found) != 1:
        pytest.fail(f"{len(found)} wheels in build/wheel: run `make wheel` (`make test` does)")
    return found[0]


def requirements(wheel: Path) -> list[Requirement]:
    """Without those of extras."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        told = email.message_from_bytes(archive.read(name))
    return wanted(told.get_all("Requires-Dist", []))


def wanted(lines: Iterable[str], extra: str = "") -> list[Requirement]:
    every = map(Requirement, lines)
    return [r for r in every if r.marker is None or r.marker.evaluate({"extra": extra})]


def with_their_own(direct: Iterable[Requirement]) -> set[str]:
    """Names of distributions: these, what they need, and so on."""
    found: set[str] = set()
    rest = list(direct)
    while rest:
        requirement = rest.pop()
        name = canonicalize_name(requirement.name)
        if name not in found:
            found.add(name)
            rest += wanted(importlib.metadata.requires(name) or [])
    return found


def link(names: Iterable[str], folder: Path) -> None:
    """Put distributions of this environment into another's folder of packages."""
    for name in names:
        found = importlib.metadata.distribution(name)
        for top in {file.parts[0] for file in found.files or []} - {"..", "__pycache__"}:
            if not (folder / top).exists():
                (folder / top).symlink_to(str(found.locate_file(top)))


class Environment:
    """A folder with a Python and the package, and nothing on the PATH."""

    def __init__(self, folder: Path, wheel: Path, names: Iterable[str]) -> None:
        self.folder = folder
        venv.create(folder, symlinks=True)
        self.packages = Path(
            self.run("-c", "import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip()
        )
        link(names, self.packages)
        install = ["install", "--quiet", "--no-index", "--disable-pip-version-check", str(wheel)]
        self.run_pip(*install)

    def run_pip(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "pip", "--python", str(self.folder / "bin" / "python")]
        subprocess.run([*command, *arguments], check=True, timeout=120)

    def run(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(self.folder / "bin" / "python"), *map(str, arguments)], cwd=self.folder,
            env={"PATH": "/nonexistent"}, capture_output=True, text=True, timeout=120,
        )  # fmt: skip

    def penumbra(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return self.run("-I", self.folder / "bin" / "penumbra", *arguments)


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """pip refuses to install what lacks a requirement, or has another version of it."""
    folder = tmp_path_factory.mktemp("bare")
    return Environment(folder, wheel, with_their_own(requirements(wheel)))


# ---------------------------------------------------------------- what is in it


def test_it_brings_along_what_it_reads_as_the_repository_has_it(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [n for n in archive.namelist() if not n.endswith("/")]
        shared = {n.removeprefix(SHARE) for n in names if n.startswith(SHARE)} - {MADE}
        assert {f"scenes/{f.name}" for f in (ROOT / "scenes").glob("*.json")} <= shared
        for name in shared:
            assert archive.read(SHARE + name) == (ROOT / name).read_bytes(), name
        assert f"{SHARE}{MADE}" in names
    tops = {n.split("/")[0] for n in names}
    assert tops == {"penumbra", "penumbra.libs", f"penumbra-{VERSION}.dist-info"}
    assert not [n for n in names if n.endswith((".exr", ".c", ".pyc"))]


def test_it_runs_on_other_linuxes_and_other_processors(wheel: Path, tmp_path: Path) -> None:
    """Its name says for which C library; no instruction is wider than every x86-64 has."""
    assert re.search(r"-py3-none-manylinux_2_\d+_(x86_64|aarch64)\.whl$", wheel.name)
    with zipfile.ZipFile(wheel) as archive:
        library = archive.extract(SHARE + MADE, tmp_path)
    listed = subprocess.run(["objdump", "-d", library], check=True, capture_output=True, text=True)
    assert "ret" in listed.stdout and not re.search("%[yz]mm", listed.stdout)


# ---------------------------------------------------------------- what it does


@pytest.mark.parametrize("name, status, word", [("right", 0, "RIGHT: "), ("wrong", 1, "WRONG: ")])
def test_it_checks_a_picture_as_the_repository_does(
    bare: Environment, name: str, status: int, word: str
) -> None:
    """With its C library, by the words that README.md shows."""
    checked = bare.penumbra("check", PICTURES / f"{name}_n016.png")
    assert (checked.returncode, checked.stderr) == (status, "")
    readme = (ROOT / "README.md").read_text()
    assert f"check/{name}_n016.png\n{checked.stdout}" in readme


def test_it_speaks_french(bare: Environment) -> None:
    """The compiled texts come along; only those who translate need Babel."""
    checked = bare.penumbra("check", PICTURES / "wrong_n016.png", "--lang", "fr", "--hint", "0")
    assert checked.returncode == 1
    assert checked.stdout.startswith("FAUX\u00a0: la lumière n’est pas calculée correctement.")


def test_its_c_library_is_loaded(bare: Environment) -> None:
    code = "from penumbra.compare.check import mistaken as m; m.opened(); print(m.LIBRARY)"
    loaded = bare.run("-I", "-c", code)
    assert loaded.stdout.strip() == str(bare.packages / SHARE / MADE), loaded.stderr


def test_the_exact_solution_compares_and_scenes_are_found_by_name(bare: Environment) -> None:
    made = bare.penumbra("exact", "tp3", "-o", "exact.exr", "--width", "60", "--height", "40")
    assert made.returncode == 0, made.stderr
    report = ("--json", "compared.json")
    compared = bare.penumbra("compare", "exact.exr", "exact", "--scene", "scenes/tp3.json", *report)
    assert compared.returncode == 0, compared.stderr
    rows = json.loads((bare.folder / "compared.json").read_text())["rows"]
    assert {row["verdict"] for row in rows} == {"agrees"}
    printed = bare.penumbra("scene", "tp3_sheared", "--as", "cpp")
    assert printed.returncode == 0 and "Scene::init()" in printed.stdout


BUILD = "in Penumbra's repository run `make build`"
PICTURE = PICTURES / "right_n016.png"


@pytest.mark.parametrize(
    "words, advice",
    [
        ("converge tp3 -o out", BUILD),
        ("trade tp3 -o out", BUILD),
        ("speedup tp3 -o out.csv", BUILD),
        ("stability -o out", BUILD),
        ("self-shadow -o out", BUILD),
        ("calibrate -o out.json", BUILD),
        ("reference tp3 -o out.exr", "run pip install 'penumbra[cycles]'"),
        ("report", "run pip install 'penumbra[report]'"),
        (f"check {PICTURE} --html out.html", "run pip install 'penumbra[report]'"),
        (
            f"compare {PICTURE} exact --scene tp3 --perceptual",
            "run pip install 'penumbra[perceptual]'",
        ),
    ],
)  # fmt: skip
def test_what_needs_more_says_so_with_status_3(bare: Environment, words: str, advice: str) -> None:
    asked = bare.penumbra(*words.split())
    assert asked.returncode == 3, asked.stderr
    assert advice in asked.stderr.splitlines()[-1]
    assert "Traceback" not in asked.stderr and not list(bare.folder.glob("out*"))


def test_pytest_finds_the_plug_in(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    names = with_their_own([*requirements(wheel), Requirement("pytest")])
    environment = Environment(tmp_path_factory.mktemp("with_pytest"), wheel, names)
    test = environment.folder / "test_mine.py"
    shutil.copy(PICTURES / "wrong_n016.png", environment.folder)
    test.write_text(
        "import penumbra\n\n"
        "def test_light():\n"
        "    penumbra.assert_right('wrong_n016.png', scene='tp3', light_samples=16)\n"
    )
    ran = environment.run("-I", "-m", "pytest", "-q", "-p", "no:cacheprovider", test)
    assert ran.returncode == 1, ran.stdout + ran.stderr
    assert "verdict: WRONG" in ran.stdout, ran.stdout


# ---------------------------------------------------------------- extras


def test_each_module_that_may_be_missing_comes_with_its_extra() -> None:
    """Those that are installed here: no Cycles for every Python."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    provided = importlib.metadata.packages_distributions()
    assert set(EXTRA_OF.values()) == set(extras)
    for module, extra in EXTRA_OF.items():
        if module in provided:
            assert canonicalize_name(provided[module][0]) in with_their_own(wanted(extras[extra]))
