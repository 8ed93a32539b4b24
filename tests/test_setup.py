"""Set-up, requirements, and what make and CI promise. Nothing is installed: apt, sudo, pip and
make are stand-ins that write down how they were called."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from penumbra.report.sections import SECTIONS, inputs_of
from penumbra.report.speed import BENCH
from tests.conftest import ROOT

COMMON_TOOLS = (
    *("bash", "cat", "cmp", "dirname", "env", "flock", "mkdir", "mktemp", "rm", "sed", "tail"),
    *("true", "uname"),
)


def script(file: Path, body: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{body}\n")
    file.chmod(0o755)
    return file


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """What set-up reads, in a folder of its own."""
    folder = tmp_path / "clone"
    folder.mkdir()
    for name in ("setup.sh", "requirements.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    return folder


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A PATH of a machine with a shell and nothing else."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for tool in COMMON_TOOLS:
        found = shutil.which(tool)
        assert found, tool
        (folder / tool).symlink_to(found)
    return folder


def set_up(
    clone: Path, path: str, level: str = "run", **more: str
) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PENUMBRA_PYTHON"}
    return subprocess.run(
        ["bash", str(clone / "setup.sh"), level], env={**environment, "PATH": path, **more},
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120,
    )  # fmt: skip


# ---------------------------------------------------------------- system packages


def test_without_apt_the_missing_packages_are_named(clone: Path, bare: Path) -> None:
    run = set_up(clone, str(bare), "test")
    assert run.returncode == 3
    last = run.stderr.splitlines()[-1]
    packages = {"gcc", "libjansson-dev", "libopenexr-dev", "python3-venv", "chromium", "clang"}
    assert packages | {"bubblewrap"} <= set(last.split())


def test_a_bubblewrap_that_may_make_no_namespaces_is_not_missing(clone: Path, bare: Path) -> None:
    script(
        bare / "bwrap",
        '[ "$*" = --version ] || { echo "bwrap: No permissions to create new namespace"; exit 1; }',
    )
    run = set_up(clone, str(bare))
    assert "missing: gcc" in run.stderr and "bubblewrap" not in run.stderr


def test_without_root_or_sudo_the_line_to_run_is_printed(clone: Path, bare: Path) -> None:
    """As user 1000. apt-get is there, but must not be called."""
    script(bare / "id", "echo 1000")
    script(bare / "apt-get", f"touch {clone}/called")
    run = set_up(clone, str(bare))
    assert run.returncode == 3
    line = run.stderr.splitlines()[-1].strip()
    assert line.startswith("sudo apt-get update && sudo apt-get install --yes ")
    assert {"gcc", "libopenexr-dev"} <= set(line.split())
    assert not (clone / "called").exists()


@pytest.mark.parametrize("user, through", [("0", ""), ("1000", "sudo -n ")])
def test_apt_is_called_as_root_or_through_sudo(
    user: str, through: str, clone: Path, bare: Path
) -> None:
    """apt here installs nothing: first without fetching package lists, then with, then it is an
    error that shows apt's own words and names the log."""
    script(bare / "id", f"echo {user}")
    script(bare / "sudo", f'echo "sudo $1 $2" >>{clone}/called; shift; exec "$@"')
    script(bare / "apt-get", f'echo "apt $*" >>{clone}/called; echo "E: no network"; exit 100')
    run = set_up(clone, str(bare))
    assert run.returncode == 3
    calls = (clone / "called").read_text().splitlines()
    verbs = [re.search(r"install|update", c)[0] for c in calls if c.startswith("apt")]  # type: ignore[index]
    assert verbs == ["install", "update", "install"]
    assert any(c.startswith("sudo -n") for c in calls) == bool(through)
    assert "E: no network" in run.stderr and "build/setup.log" in run.stderr.splitlines()[-1]
    assert "E: no network" in (clone / "build/setup.log").read_text()


def test_an_unknown_level_is_a_usage_error(clone: Path, bare: Path) -> None:
    run = set_up(clone, str(bare), "everything")
    assert run.returncode == 2
    assert "everything" in run.stderr and "run | course | test" in run.stderr


# ---------------------------------------------------------------- .venv


@pytest.fixture
def python(clone: Path, tmp_path: Path) -> Path:
    """An interpreter whose venvs hold a pip that writes down its call in `called`, and fails
    while the file `broken` exists."""
    fake_venv = (
        f"rm -rf .venv && mkdir -p .venv/bin && cp {tmp_path}/fake_pip .venv/bin/python"
        " && chmod +x .venv/bin/python"
    )
    script(
        tmp_path / "fake_pip",
        f'case "$*" in *"pip install"*) echo "$*" >>called; [ ! -e broken ];;'
        f' *) exec {sys.executable} "$@";; esac',
    )
    return script(
        tmp_path / "python",
        f'[ "$2" != venv ] || {{ {fake_venv}; exit; }}\n'
        f'[ "$1" != -c ] || case "$2" in *ensurepip*) echo "$0"; exit;; esac\n'
        f'exec {sys.executable} "$@"',
    )


def test_an_interrupted_venv_is_not_taken_for_a_complete_one(clone: Path, python: Path) -> None:
    """Fails, then succeeds, then has nothing to do, until requirements.txt changes."""

    def calls() -> int:
        run = set_up(clone, os.environ["PATH"], PENUMBRA_PYTHON=str(python))
        outcome.append(run.returncode)
        called = clone / "called"
        count = len(called.read_text().splitlines()) if called.exists() else 0
        called.unlink(missing_ok=True)
        return count

    outcome: list[int] = []
    (clone / "broken").touch()
    assert (calls(), outcome[-1]) == (1, 3)  # pip fails on the requirements
    (clone / "broken").unlink()
    assert (calls(), outcome[-1]) == (2, 0)  # requirements, then penumbra itself
    assert (calls(), outcome[-1]) == (0, 0)
    with (clone / "requirements.txt").open("a") as stream:
        stream.write("# changed\n")
    assert (calls(), outcome[-1]) == (2, 0)


def test_a_moved_clone_gets_a_venv_of_its_own(clone: Path, python: Path) -> None:
    """A venv's programs name its folder: in a moved or copied one they start another's Python."""
    assert set_up(clone, os.environ["PATH"], PENUMBRA_PYTHON=str(python)).returncode == 0
    moved = clone.rename(clone.with_name("moved"))
    (moved / "called").unlink()
    assert set_up(moved, os.environ["PATH"], PENUMBRA_PYTHON=str(python)).returncode == 0
    assert "--require-hashes" in (moved / "called").read_text()


def test_a_python_that_cannot_be_used_is_refused(clone: Path) -> None:
    run = set_up(clone, os.environ["PATH"], PENUMBRA_PYTHON="/bin/false")
    assert run.returncode == 3
    assert "PENUMBRA_PYTHON=/bin/false" in run.stderr
    assert not (clone / ".venv").exists()


# ---------------------------------------------------------------- requirements.txt


def pins() -> list[tuple[Requirement, list[str]]]:
    """Each requirement with its hashes."""
    text = (ROOT / "requirements.txt").read_text().replace("\\\n", " ")
    lines = [line.split(" --hash=") for line in text.splitlines()]
    return [(Requirement(line[0].strip()), [h.strip() for h in line[1:]]) for line in lines]


def direct_requirements() -> list[Requirement]:
    """Of every use, of each extra, and of development."""
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = told["project"]
    groups = (project["optional-dependencies"] | told["dependency-groups"]).values()
    every = map(Requirement, itertools.chain(project["dependencies"], *groups))
    return [r for r in every if r.name != project["name"]]  # an extra that brings another


def test_every_requirement_is_an_exact_version_with_hashes() -> None:
    for requirement, hashes in pins():
        assert re.fullmatch(r"==[0-9][^*,]*", str(requirement.specifier)), requirement
        assert hashes and all(re.fullmatch("sha256:[0-9a-f]{64}", h) for h in hashes), requirement


def test_requirements_name_no_package_index() -> None:
    for name in ("requirements.txt", "pyproject.toml"):
        assert not re.search(r"://|index-url|find-links|trusted-host", (ROOT / name).read_text())


@pytest.mark.parametrize(
    "version, machine, cycles",
    [
        ("3.11", "x86_64", "4.5.15"),
        ("3.12", "x86_64", None),
        ("3.13", "x86_64", "5.2.3"),
        ("3.11", "aarch64", None),
        ("3.13", "aarch64", None),
    ],
)
def test_each_python_gets_one_version_of_all_it_needs_and_cycles_where_there_is_one(
    version: str, machine: str, cycles: str | None
) -> None:
    here = {
        "python_version": version, "python_full_version": f"{version}.2",
        "platform_machine": machine, "sys_platform": "linux",
    }  # fmt: skip
    pinned: dict[str, str] = {}
    for requirement, _ in pins():
        if requirement.marker is None or requirement.marker.evaluate(here):
            name = canonicalize_name(requirement.name)
            assert name not in pinned
            pinned[name] = str(requirement.specifier).removeprefix("==")
    assert pinned.get("bpy") == cycles
    for direct in direct_requirements():
        if direct.marker is None or direct.marker.evaluate(here):
            assert direct.specifier.contains(pinned[canonicalize_name(direct.name)])


# ---------------------------------------------------------------- make and CI


def make(*arguments: str) -> str:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS"))}
    run = subprocess.run(
        ["make", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_make_help_tells_every_target_that_is_not_a_file() -> None:
    told = [line.partition(" : ")[0] for line in make().splitlines()]
    assert sorted(told) == sorted(
        re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)
    )


def test_make_report_runs_the_commands_that_the_page_prints() -> None:
    """What the page tells its reader to type is what made it."""
    lines = make("--dry-run", "--always-make", "report").replace("\\\n", " ").splitlines()
    commands = [" ".join(line.split()).replace(".venv/bin/", "") for line in lines]
    for item in (i for i in inputs_of(SECTIONS) if i.file != BENCH.file and not i.shipped):
        assert any(item.command in command for command in commands), item.command


def test_ci_runs_make_test_in_the_repository_and_fails_with_it(tmp_path: Path) -> None:
    called = tmp_path / "called"
    script(tmp_path / "bin/make", f'echo "$PWD $*" >>{called}; exit 7')
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    run = subprocess.run(
        [str(ROOT / ".ci/run")], cwd=tmp_path, env={**os.environ, "PATH": path},
        stdin=subprocess.DEVNULL, timeout=30,
    )  # fmt: skip
    assert (run.returncode, called.read_text().split()) == (7, [str(ROOT), "test"])
