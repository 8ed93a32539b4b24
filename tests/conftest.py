"""What every test shares: the built programs, and scenes made to measure."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from penumbra.compare.measure.image import Image, read_image

STRESS = int(os.environ.get("PENUMBRA_STRESS", "1"))
"""How many times its usual number of cases a test of many runs; `make stress` sets it."""
ROOT = Path(__file__).resolve().parent.parent

# what is said depends on no developer's
for variable in ("LANGUAGE", "LC_ALL", "LC_MESSAGES", "PENUMBRA_COURSE"):
    os.environ.pop(variable, None)
os.environ["LANG"] = "C.UTF-8"


def built(product: str) -> Path:
    path = ROOT / "build" / product
    if not path.exists():
        pytest.fail(f"build/{product} is missing: run `make build` (`make test` does)")
    return path


@pytest.fixture(scope="session")
def course_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lesson's page, made once for all tests of a process."""
    from penumbra.course.page import write_page

    wanted = ("wasm/core.wasm", "wasm/mistakes.wasm", "bin/penumbra-render", "lib/libmistakes.so")
    for product in wanted:
        built(product)
    page = tmp_path_factory.mktemp("course") / "index.html"
    write_page(ROOT / "build", page)
    return page


def default_signals() -> None:
    """For preexec_fn of programs that are to be stopped: what runs in a shell's background
    (`make test &`) inherits that SIGINT is ignored."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


@pytest.fixture(scope="session")
def renderer() -> Path:
    """The C program."""
    return built("bin/penumbra-render")


@pytest.fixture(scope="session")
def scenes() -> Path:
    return ROOT / "scenes"


@pytest.fixture
def render(renderer: Path, tmp_path: Path) -> Callable[..., Image]:
    """render(scene_file, light_samples=16, ...) runs the C program and reads its image;
    precision="float64" its other build."""

    def run(scene: Path, precision: str = "float32", **options: int | float | str) -> Image:
        out = tmp_path / "render.exr"
        program = renderer if precision == "float32" else built("bin/penumbra-render-float64")
        command = [str(program), str(scene), "-o", str(out)]
        for name, value in options.items():
            command += [f"--{name.replace('_', '-')}", str(value)]
        subprocess.run(command, check=True, timeout=300)
        return read_image(out)

    return run


@pytest.fixture
def make_scene(tmp_path: Path) -> Callable[..., Path]:
    """make_scene(key=value, ...) writes the lab's scene with those top-level keys replaced."""

    def make(base: str = "tp3", file_name: str = "scene.json", **changes: Any) -> Path:
        data = json.loads((ROOT / "scenes" / f"{base}.json").read_text())
        data.update(changes)
        file = tmp_path / file_name
        file.write_text(json.dumps({k: v for k, v in data.items() if v is not None}, indent=1))
        return file

    return make


@pytest.fixture(scope="session")
def plain_environment() -> dict[str, str]:
    """The environment without what would change messages or threads."""
    drop = ("OMP_NUM_THREADS", "NO_COLOR", "PYTEST_CURRENT_TEST")
    return {k: v for k, v in os.environ.items() if k not in drop}
