"""What a teacher hands out: made whole, accessible, in two languages that agree, and of commands
that really make it."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
import typst
from nbclient import NotebookClient
from PIL import Image as PillowImage

from penumbra.compare.check.catalogue import catalogue
from penumbra.compare.cpp import cpp_scene
from penumbra.compare.exact.image import exact_image, regions
from penumbra.compare.scene import read_scene
from penumbra.course.figures import LIGHT_SAMPLES, PICTURES, commands
from penumbra.course.handout import (
    FIGURES,
    HANDED_OUT,
    NOTEBOOK,
    SOURCES,
    compiled,
    frequencies,
    numbers,
    write_handouts,
)
from penumbra.course.page import PARTS
from penumbra.grading.rubric import read_rubric
from penumbra.language import LANGUAGES
from tests.conftest import ROOT, built

DOCUMENTS = [f"{name}-{language}" for name in ("handout", "notes") for language in LANGUAGES]
TITLES = {
    "handout-en": "Surface lights and soft shadows",
    "handout-fr": "Sources surfaciques et ombres douces",
    "notes-en": "Soft shadows: notes for the teacher",
    "notes-fr": "Ombres douces\u00a0: notes pour l’enseignant",
}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that is handed out, without the page."""
    for product in ("bin/penumbra-render", "lib/libmistakes.so"):
        built(product)
    folder = tmp_path_factory.mktemp("course")
    write_handouts(folder)
    return folder


@pytest.fixture(scope="module")
def work(out: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources beside the figures, as Typst has them."""
    folder = tmp_path_factory.mktemp("work")
    shutil.copytree(SOURCES, folder, dirs_exist_ok=True)
    shutil.copytree(out / "figures", folder / "figures")
    return folder


@pytest.fixture(scope="module")
def data(out: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    images = tmp_path_factory.mktemp("images")
    rendered = {picture.name: picture.render(images) for picture in PICTURES}
    return numbers(rendered, images)


def query(work: Path, data: dict[str, Any], document: str, selector: str) -> Any:
    """The elements of a document, as Typst lays it out."""
    inputs = {"data": json.dumps(data | {"language": document[-2:]})}
    found = typst.query(
        str(work / f"{document}.typ"),
        selector,
        root=str(work),
        ignore_system_fonts=True,
        sys_inputs=inputs,
    )
    return json.loads(found)


def said(element: Any) -> str:
    """The text of an element of a query."""
    if isinstance(element, list):
        return "".join(map(said, element))
    if not isinstance(element, dict):
        return ""
    if element.get("func") == "space":
        return " "
    return str(element.get("text", "")) + "".join(
        said(element[key]) for key in ("body", "children") if key in element
    )


def rows(table: dict[str, Any]) -> list[list[str]]:
    """A table's, without the header's."""
    cells = [said(cell) for cell in table["children"] if cell["func"] == "cell"]
    columns = table["columns"]
    width = columns if isinstance(columns, int) else len(columns)
    return [cells[i : i + width] for i in range(0, len(cells), width)]


# ---------------------------------------------------------------- files


def test_everything_that_is_handed_out_is_there(out: Path) -> None:
    for file, _ in HANDED_OUT:
        for language in LANGUAGES:
            assert (out / file.format(language=language)).stat().st_size > 0
    figures = {file.name for file in (out / "figures").iterdir()}
    assert figures == {
        *(f"{picture.name}.png" for picture in PICTURES),
        "figure-2.png",
        *(f"figure-{n}-{language}.pdf" for n in FIGURES for language in LANGUAGES),
    }
    assert not list(out.rglob("*.part"))


def pdf_files(out: Path) -> Iterator[Path]:
    yield from sorted(out.rglob("*.pdf"))


def test_every_pdf_says_that_it_is_accessible_and_in_which_language(out: Path) -> None:
    """PDF/UA-1 (ISO 14289-1): the identifier in the metadata, a tagged structure, a language, a
    title that viewers show."""
    seen = 0
    for file in pdf_files(out):
        pdf = file.read_bytes()
        catalog = re.search(rb"<</Type/Catalog.*", pdf)
        assert catalog
        assert b"<pdfuaid:part>1</pdfuaid:part>" in pdf
        assert f"/Lang({file.stem[-2:]})".encode() in catalog.group()
        assert b"/MarkInfo<</Marked true" in catalog.group()
        assert b"/StructTreeRoot" in catalog.group()
        assert b"/DisplayDocTitle true" in catalog.group()
        title = re.search(rb"<dc:title>.*?<rdf:li[^>]*>(.*?)</rdf:li>", pdf, re.DOTALL)
        assert title
        if file.stem in TITLES:
            assert title.group(1).decode() == TITLES[file.stem]
        else:
            assert title.group(1).decode() == file.stem[:-3].replace("-", " ").capitalize()
        seen += 1
    assert seen == len(DOCUMENTS) + len(FIGURES) * len(LANGUAGES)


@pytest.mark.parametrize(
    ("with_it", "without"),
    [
        ('magnified("figure-3", 52%, words.one)', 'magnified("figure-3", 52%, none)'),
        ("math.equation(block: true, alt: alt, body)", "body"),
    ],
    ids=["picture", "formula"],
)
def test_what_has_no_alternative_text_is_refused(
    work: Path, data: dict[str, Any], tmp_path: Path, with_it: str, without: str
) -> None:
    shutil.copytree(work, tmp_path, dirs_exist_ok=True)
    style = tmp_path / "style.typ"
    text = style.read_text(encoding="utf-8")
    assert with_it in text
    style.write_text(text.replace(with_it, without), encoding="utf-8")
    with pytest.raises(typst.TypstError, match="missing alt text"):
        compiled(tmp_path / "handout-en.typ", data | {"language": "en"})


def test_the_same_bytes_are_made_twice_and_wherever(
    out: Path, work: Path, data: dict[str, Any]
) -> None:
    """Neither a date nor a folder's name is in them."""
    for name in DOCUMENTS:
        again = compiled(work / f"{name}.typ", data | {"language": name[-2:]})
        assert again == (out / f"{name}.pdf").read_bytes(), name


@pytest.mark.parametrize(("document", "fewest", "most"), [("handout", 3, 5), ("notes", 3, 5)])
@pytest.mark.parametrize("language", LANGUAGES)
def test_a_document_is_as_long_as_one_reads(
    out: Path, document: str, language: str, fewest: int, most: int
) -> None:
    pages = re.search(rb"<xmpTPg:NPages>(\d+)", (out / f"{document}-{language}.pdf").read_bytes())
    assert pages and fewest <= int(pages.group(1)) <= most


# ---------------------------------------------------------------- figures


def test_the_commands_under_a_figure_make_it(out: Path, tmp_path: Path) -> None:
    """Typed as they stand, in the repository, but for what they write: byte for byte."""
    for name in ("build", "scenes", "penumbra", ".venv"):
        (tmp_path / name).symlink_to(ROOT / name)
    environment = {"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin"}
    for number, lines in commands().items():
        subprocess.run(
            ["sh", "-e", "-c", "\n".join(lines)], cwd=tmp_path, env=environment, check=True
        )
        made = sorted(tmp_path.glob(f"figure-{number}*.png"))
        assert made
        for file in made:
            assert file.read_bytes() == (out / "figures" / file.name).read_bytes(), file.name
    assert len(list(tmp_path.glob("figure-*.png"))) == len(PICTURES) + 1


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_handout_prints_those_commands(work: Path, data: dict[str, Any], language: str) -> None:
    printed = [raw["text"] for raw in query(work, data, f"handout-{language}", "raw")]
    for number in FIGURES:
        for line in commands()[number]:
            assert line in printed


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_a_figure_is_as_bright_as_the_exact_solution(
    picture: Any, out: Path, tmp_path: Path
) -> None:
    """The lit floor's mean within four standard errors of its own (a chance of 6e-5 for each of
    seven figures), or without noise within 2e-6, float32's rounding. Figures of 0.750 of that would
    be hundreds of standard errors off. And the picture is that image: truncated to 8 bits."""
    image = picture.render(tmp_path)
    scene = read_scene(ROOT / "scenes" / f"{picture.scene}.json")
    exact = exact_image(scene)
    lit = regions(scene, exact)["floor:lit"]
    should = float(exact.radiance[lit].mean())
    off = float(image.radiance[lit].mean()) - should
    if "exact" in picture.options:
        assert abs(off) < 2e-6 * should
    else:
        # From the scatter about the exact pixels, which N = 1 shows too.
        scatter = (image.radiance - exact.radiance)[lit].mean(axis=-1)
        error = float(scatter.std()) / math.sqrt(len(scatter))
        assert abs(off) < 4 * error
        assert 0.1 * should > 100 * error
    levels = np.asarray(PillowImage.open(out / "figures" / f"{picture.name}.png"))
    assert (levels == (np.clip(image.radiance, 0, 1) * 255).astype(np.uint8)).all()


def test_figures_3_and_4_differ_in_their_light_samples_alone(tmp_path: Path) -> None:
    several = [picture.render(tmp_path) for picture in PICTURES[2:]]
    counts = [int(image.attributes["lightSamples"]) for image in several]
    assert counts == [1, *LIGHT_SAMPLES] == [1, 4, 16, 64, 256]
    assert {int(image.attributes["pixelSamples"]) for image in several} == {1}


def test_each_row_of_errors_halves_the_one_before(data: dict[str, Any]) -> None:
    """As the notes say. N grows by 4. The error of each figure is over some 9,000 pixels of
    penumbra, so known to about 1%, and the ratio of two to 2%: 10% is beyond chance."""
    for column in ("penumbra", "lit"):
        errors = [row[column] for row in data["errors"]]
        for before, after in pairwise(errors):
            assert before / after == pytest.approx(2, rel=0.1)


def test_at_equal_rays_there_is_equal_noise(data: dict[str, Any]) -> None:
    """The answer to the question about anti-aliasing, to 5%; and it is the errors' own measure."""
    four, smoothed, many = (row["noise"] for row in data["equal_rays"])
    assert [(row["n"], row["m"]) for row in data["equal_rays"]] == [(4, 1), (4, 16), (64, 1)]
    assert smoothed == pytest.approx(many, rel=0.05)
    assert four == pytest.approx(4 * many, rel=0.05)
    by_n = {row["n"]: row["penumbra"] for row in data["errors"]}
    assert four == pytest.approx(by_n[4], rel=0.05) and many == pytest.approx(by_n[64], rel=0.05)


def test_the_floors_radiances_are_those_of_the_limit(data: dict[str, Any]) -> None:
    """Against brute force with 4 million points each, whose relative errors are up to 1e-5."""
    brute_force = {
        (-1.0, -2.0, 2.0): 1.01930774,
        (1.3, -2.0, 3.0): 0.79775183,
        (0.0, -2.0, 1.8): 0.54903358,
        (0.0, -2.0, 3.0): 0.0,
    }
    found = {tuple(row["place"]): row["radiance"] for row in data["places"]}
    assert found == pytest.approx(brute_force, rel=2e-5)


# ---------------------------------------------------------------- what is generated


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_appendix_has_the_scenes_own_lines(
    work: Path, data: dict[str, Any], language: str
) -> None:
    printed = [
        raw["text"] for raw in query(work, data, f"handout-{language}", "raw.where(block: true)")
    ]
    tp3 = cpp_scene(read_scene(ROOT / "scenes" / "tp3.json"))
    assert printed[0] == tp3
    others = sorted((ROOT / "scenes").glob("tp3_*.json"))
    assert len(printed) == 1 + len(others)
    for file, lines in zip(others, printed[1:], strict=True):
        whole = cpp_scene(read_scene(file)).splitlines()
        assert lines.splitlines() == [line for line in whole[1:] if line not in tp3.splitlines()]


def test_scenes_come_with_their_lines(out: Path) -> None:
    for file in (out / "scenes").glob("*.json"):
        assert file.read_bytes() == (ROOT / "scenes" / file.name).read_bytes()
        assert file.with_suffix(".txt").read_text() == cpp_scene(read_scene(file))
    handed_out = {file.name for file in (out / "scenes").glob("*.json")}
    every = {file.name for file in (ROOT / "scenes").glob("*.json")}
    assert handed_out == every - {"scene.schema.json"}


def test_frequencies_are_of_mistakes_that_the_museum_has() -> None:
    """But for the camera's, which is no fault of the light. No more repositories than there are."""
    found = frequencies()
    named = {*found["mistakes"], *found["latent"]} - {"field_of_view"}
    assert named <= set(catalogue().mistakes)
    assert all(1 <= count <= found["repositories"] for count in found["mistakes"].values())


def test_links_lead_to_places_of_the_page() -> None:
    places = {"main", *(part.name for part in PARTS)}
    lesson = (SOURCES.parent / "lesson" / "en.md").read_text(encoding="utf-8")
    places |= set(re.findall(r"\{#([\w-]+)\}", lesson))
    linked: set[str] = set()
    for file in SOURCES.glob("*.typ"):
        linked |= set(re.findall(r"place-of\(\"([\w-]+)\"\)", file.read_text(encoding="utf-8")))
    assert {"main", "drop", "museum", "umbra", "trade"} <= linked <= places


@pytest.mark.parametrize("language", LANGUAGES)
def test_notes_state_every_frequency(work: Path, data: dict[str, Any], language: str) -> None:
    tables = query(work, data, f"notes-{language}", "table")
    stated = [row[1] for row in rows(tables[1])]
    assert stated == [str(count) for count in frequencies()["mistakes"].values()]


@pytest.mark.parametrize("language", LANGUAGES)
def test_notes_state_the_rubric(work: Path, data: dict[str, Any], language: str) -> None:
    rubric = read_rubric()
    keys = [criterion.claim for criterion in rubric.criteria]
    tables = query(work, data, f"notes-{language}", "table")
    (table,) = (found for found in map(rows, tables) if found[0][0] == keys[0])
    assert [(row[0], row[-1]) for row in table[:-1]] == [
        (criterion.claim, str(criterion.points)) for criterion in rubric.criteria
    ]
    assert table[-1][-1] == str(rubric.total)


def test_notes_that_lack_a_mistake_or_a_claim_are_refused(work: Path, data: dict[str, Any]) -> None:
    more = json.loads(json.dumps(data))
    more["frequencies"]["mistakes"]["black"] = 1
    with pytest.raises(typst.TypstError, match="frequencies"):
        compiled(work / "notes-fr.typ", more | {"language": "fr"})
    more = json.loads(json.dumps(data))
    more["rubric"]["points"]["style"] = 1
    with pytest.raises(typst.TypstError, match=r"rubric\.toml"):
        compiled(work / "notes-en.typ", more | {"language": "en"})


# ---------------------------------------------------------------- two languages


@pytest.mark.parametrize("name", ["handout", "notes", "figures"])
def test_both_languages_have_the_same_numbers_and_the_same_parts(name: str) -> None:
    """In order, but for French's comma; as many headings, items, figures, formulas, links."""
    english, french = (
        (SOURCES / f"{name}-{language}.typ").read_text(encoding="utf-8") for language in LANGUAGES
    )
    french_numbers = re.sub(r"(?<=\d),(?=\d)", ".", french)
    assert re.findall(r"\d+(?:\.\d+)?", french_numbers) == re.findall(r"\d+(?:\.\d+)?", english)
    for part in (
        r"^=+ ",
        r"^\+ ",
        r"^- ",
        r"#numbered",
        r"formula\(",
        r"#m\(",
        "#question",
        "link",
    ):
        assert len(re.findall(part, english, re.M)) == len(re.findall(part, french, re.M)), part
    assert re.findall(r"\$[^$]*\$", english) == re.findall(r"\$[^$]*\$", french)


@pytest.mark.parametrize("name", ["handout", "notes", "figures"])
def test_french_has_no_break_spaces_and_quotes_of_its_own(name: str) -> None:
    text = (SOURCES / f"{name}-fr.typ").read_text(encoding="utf-8")
    text = re.sub(r"`[^`]*`|\$[^$]*\$|#code\(\"[^\"]*\"\)", "", text)
    assert not re.search(r" [:;!?%»]|« |“|”", text)
    assert not re.search(r"\w[;!?»](?=\s)", text)
    assert not re.search(r"\d\.\d+(?!\d|pt|fr|em|cm)", text)


# ---------------------------------------------------------------- the notebook


def test_the_notebook_is_kept_without_outputs_and_in_both_languages() -> None:
    book = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(book)
    for cell in book.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
        else:
            head, french, english = cell.source.split("\n\n")
            assert head.startswith("#") and " · " in head and english.startswith("> ")
            assert not re.search(r" [:;!?%»]", french.replace(" · ", ""))


def test_the_notebook_runs_and_finds_the_slope_and_the_mistake(out: Path) -> None:
    """The slope's 95% interval holds -1/2 for the seeds that are handed out, and the wrong image's
    mistake is the one that was made."""
    folder = out / "notebook"
    book = nbformat.read(folder / NOTEBOOK.name, as_version=4)
    NotebookClient(
        book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    ).execute()
    printed = "\n".join(
        output.text for cell in book.cells for output in cell.get("outputs", []) if "text" in output
    )
    fit = re.search(r"(-0\.\d+)  \(95%: (-0\.\d+) – (-0\.\d+)\)", printed)
    assert fit, printed
    slope, low, high = map(float, fit.groups())
    assert low <= slope <= high and low <= -0.5 <= high and high - low < 0.05
    assert "the cosine of a cosine is taken" in printed and "n16_m1.png: OK" in printed
    assert "differs" not in printed and printed.count("agrees") > 5
    pictures = [
        output
        for cell in book.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 2


# ---------------------------------------------------------------- what may be missing


def test_without_typst_the_command_names_what_to_install(tmp_path: Path) -> None:
    script = (
        "import sys\nsys.modules['typst'] = None\nfrom penumbra.__main__ import main\n"
        f"sys.exit(main(['course', '-o', {str(tmp_path / 'course')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 3
    assert "typst is not installed: run ./setup.sh" in done.stderr
    assert not list(tmp_path.rglob("*.pdf"))
