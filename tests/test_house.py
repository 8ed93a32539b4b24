"""The house: which folder of the C renderer may use which, and where a light's shape is known."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "c_renderer" / "src"
BESIDE = tuple(ROOT / "c_renderer" / name for name in ("mistakes", "wasm"))
"""What is made of the floors, and is no part of the program"""
FLOORS = ("core", "exact", "packet", "frame", "io")
"""From the ground up: each may include itself and those before it."""
SHAPES = ("POINT", "QUAD", "DISK", "TRIANGLE", "SPHERE")


def sources(floor: str) -> list[Path]:
    return sorted((SOURCES / floor).glob("*.[ch]"))


@pytest.mark.parametrize("floor", FLOORS)
def test_arrows_run_downwards_only(floor: str) -> None:
    """core/, what students read, so includes nothing of the other four."""
    below = FLOORS[: FLOORS.index(floor)]
    assert sources(floor)
    for file in sources(floor):
        for name in re.findall(r'#include "([^"]+)"', file.read_text()):
            folder, _, _ = name.rpartition("/")
            assert folder in below if folder else (file.parent / name).exists(), (file.name, name)


@pytest.mark.parametrize("folder", BESIDE, ids=lambda folder: folder.name)
def test_what_stands_beside_the_renderer_uses_its_headers(folder: Path) -> None:
    """Its own, and those of the floors below io/; a page's module those of the mistakes too."""
    files = sorted(folder.glob("*.[ch]"))
    assert files
    below = ["../mistakes"] if folder.name == "wasm" else []
    for file in files:
        for name in re.findall(r'#include "([^"]+\.h)"', file.read_text()):
            place, _, _ = name.rpartition("/")
            assert place in (*FLOORS[:-1], *below) if place else (folder / name).exists(), name


def test_core_can_be_read_in_one_sitting() -> None:
    """No file of it is longer than the longest of minilight's."""
    lengths = {file.name: len(file.read_text().splitlines()) for file in sources("core")}
    assert max(lengths.values()) <= 343
    assert sum(lengths.values()) <= 1700, lengths


def test_every_choice_by_shape_is_a_switch_that_lists_them_all() -> None:
    """So that the compiler names each place that a new shape touches: no comparison of a type, and
    no `default` where shapes are chosen."""
    beside = sorted(BESIDE[1].glob("*.[ch]"))
    for file in [*(f for floor in FLOORS for f in sources(floor)), *beside]:
        text = file.read_text()
        assert not re.search(r"[!=]= *LIGHT_|LIGHT_[A-Z]+ *[!=]=", text), file.name
        for indent, switch in re.findall(
            r"^( *)switch \([^)]*type\) (\{[\s\S]*?\n\1\}\n)(?! *case)", text, re.M
        ):
            assert not re.search(rf"^{indent}default:", switch, re.M), file.name
            for shape in SHAPES:
                assert f"case LIGHT_{shape}:" in switch, (file.name, shape)
