"""docs/adding-a-light.md and the code: what it names knows every shape, and nothing else does."""

from __future__ import annotations

import re

import pytest

from tests.conftest import ROOT

PAGE = ROOT / "docs" / "adding-a-light.md"
SHAPES = ("triangle", "disk", "sphere")
"""A quad is known beside them by scenes and studies of the lab's own light."""
KNOWS = {
    shape: re.compile(
        rf"{shape}[_-]?light|light_{shape}|{shape}_place|spherical_{shape}|{shape}_(outline|range)"
        rf'|tp3_{shape}|"{shape}"|\b{shape}\(',
        re.IGNORECASE,
    )
    for shape in SHAPES
}
SOURCES = ("c_renderer/src", "c_renderer/wasm", "penumbra", "bench", "scenes")


def named() -> list[str]:
    """The files that the page links to."""
    found = re.findall(r"\]\(\.\./([^)#]+)\)", PAGE.read_text())
    beside = [f.replace("triangle.h", "triangle.c") for f in found if f.endswith("triangle.h")]
    return sorted({*found, *beside})


def shapes_of(file: str) -> set[str]:
    text = (ROOT / file).read_text()
    return {shape for shape, pattern in KNOWS.items() if pattern.search(text)}


@pytest.mark.parametrize("file", [f for f in named() if "triangle." not in f])
def test_each_place_that_the_page_names_knows_every_shape(file: str) -> None:
    assert shapes_of(file) == set(SHAPES)


def test_no_other_file_names_a_shape() -> None:
    """But for each shape's own, and the scenes: lights there are data."""
    own = {f"c_renderer/src/core/{shape}.{kind}" for shape in SHAPES for kind in "ch"}
    files = [
        path
        for folder in SOURCES
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".c", ".h", ".py", ".js", ".json") and not path.stem.startswith("tp3_")
    ]
    assert len(files) > 100
    light = re.compile(r"(triangle|disk|sphere)_?lights?\b", re.IGNORECASE)
    knowing = {str(path.relative_to(ROOT)) for path in files if light.search(path.read_text())}
    assert knowing - own <= set(named())
