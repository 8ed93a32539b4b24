"""The course's page checks a picture in the browser, and says what `penumbra check` says of it.

Pictures are made by renderers whose mistake, or whose want of one, is known. PENUMBRA_STRESS=n
takes n times as many, of all mistakes and nuisances, by another draw.
"""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image, PngImagePlugin
from playwright.sync_api import Page

from penumbra.compare.check.calibration import SIZES, draw
from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.checking import Checked, Checker, check
from penumbra.compare.check.explanation import text
from penumbra.compare.check.picture import counts_in_name
from penumbra.compare.check.specimens import Specimen
from penumbra.compare.check.words import WORDS
from penumbra.course.drop import PARAMETERS, SCENES, catalogue_script, javascript
from penumbra.course.page import write_page
from tests import section
from tests.conftest import ROOT, STRESS, built

SCENE = ROOT / "scenes" / "tp3.json"
OPPOSITE = {"right", "wrong"}
CHECK = """async ([content, name, options]) => {
  const bytes = Uint8Array.from(atob(content), (character) => character.charCodeAt(0));
  try {
    return await checkPicture(new File([bytes], name), options);
  } catch (error) {
    return { refused: error.code || String(error) };
  }
}"""


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for product in ("wasm/core.wasm", "wasm/mistakes.wasm", "lib/libmistakes.so"):
        built(product)
    file = tmp_path_factory.mktemp("course") / "index.html"
    write_page(ROOT / "build", file)
    return file


@pytest.fixture(scope="module")
def tab(page_file: Path) -> Iterator[Page]:
    """The page in English, in which nothing complains and which asks for nothing."""
    heard: list[str] = []
    with section.browser() as started:
        page = started.new_page(viewport={"width": 1100, "height": 900})
        page.set_default_timeout(120_000)
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("request", lambda request: heard.append(request.url)
                if request.url.partition(":")[0] not in ("file", "data", "blob") else None)  # fmt: skip
        page.goto(f"{page_file.as_uri()}?lang=en#drop")
        page.wait_for_selector("#drop-form:not([hidden])")
        yield page
    assert heard == []


def specimen(variant: Variant, n: int = 16, m: int = 1, **nuisances: Any) -> Specimen:
    kind = "single" if variant.mistakes else "correct"
    given = {"shape": SIZES[0], "seed": 5} | nuisances
    return Specimen(
        kind, given.pop("scene", "tp3"), ("mistakes",), variant, given.pop("shape"), ((n, m),),
        **given,
    )  # fmt: skip


FEW = [
    specimen(Variant()),
    specimen(Variant(), n=64, position=(0.0, 0.0), divisor=1, file="jpg 100"),
    specimen(Variant(), n=4, scene="tp3_statement", position=None),
    specimen(Variant(), n=16, fov_y_deg=70.0, encoding="sRGB"),
    specimen(Variant(), n=1, power=1.5, offset="offset_0_01"),
    specimen(Variant(), n=4, m=4, file="bmp", ray_max_distance=1000.0),
    specimen(Variant(), n=16, file="jpg 90", position=(1.5, 0.5)),
    specimen(Variant(domain="diagonal"), scene="tp3_statement"),
    specimen(Variant(domain="corner")),
    specimen(Variant(visibility="to_centre"), position=(0.0, 0.0)),
    specimen(Variant(visibility="offset_0_3"), n=64),
    specimen(Variant(weight="pdf_times_cos"), file="jpg 100"),
    specimen(Variant(weight="no_light_cosine"), n=1),
    specimen(Variant(scale="area_3"), encoding="rounded"),
    specimen(Variant(average="n_no_effect")),
    specimen(Variant(average="break_first"), position=None),
    specimen(Variant(clamp="per_light_sample")),
    specimen(Variant(output="ambient_0_1"), scene="tp3_statement"),
    specimen(Variant(generator="same_everywhere")),
    specimen(Variant(weight="cos_of_cos_receiver", average="not_divided_by_n"), n=4),
]


def many() -> list[Specimen]:
    """Of a draw as calibration makes it, what the page takes: one picture, of the lab's scene, in
    8 bits."""
    found = []
    for i, s in enumerate(draw(1, 25 * STRESS, 100 + STRESS)):
        if s.kind == "left out" or s.variant.lights != "std" or s.variant.scale == "area_by_norms":
            continue
        scene = s.scene if s.scene in SCENES else SCENES[i % 2]
        file = "png" if s.file == "exr" else s.file
        found.append(replace(s, scene=scene, file=file, counts=s.counts[-1:]))
    return found


def checked_by_page(tab: Page, file: Path, s: Specimen) -> dict[str, Any]:
    n, m = s.counts[0]
    content = base64.b64encode(file.read_bytes()).decode()
    options = {"scene": s.scene, "lightSamples": n, "pixelSamples": m}
    found: dict[str, Any] = tab.evaluate(CHECK, [content, file.name, options])
    return found


def test_page_says_what_the_command_says(tab: Page, tmp_path: Path) -> None:
    """The same verdict, the same mistakes in the same order, the same facts, the same score; where
    the command names a mistake by where the light seems to be, the page may say "unknown" or that
    it cannot tell. Never the opposite, and no correct renderer is accused."""
    checker = Checker()
    tally: dict[str, int] = {}
    failures = []
    for s in FEW if STRESS == 1 else many():
        file = s.files(tmp_path)[0]
        mine = check([file], s.scene_file, *s.counts[0], checker)
        verdict, ours = mine.verdict, checked_by_page(tab, file, s)
        said = ours.get("verdict", ours.get("refused"))
        # of light that is fitted to places the page knows nothing
        free = mine.diagnosis.light is not None and said in ("cannot tell", "wrong")
        same = said == verdict.verdict and tuple(ours["mistakes"]) == verdict.mistakes
        gain = mine.diagnosis.best.score - mine.diagnosis.right.score
        agrees = same and abs(ours["gain"] - gain) < 1e-3 * max(abs(gain), 1) + 0.05 * bool(
            s.file[:3] == "jpg"
        )
        agrees = agrees and [fact["code"] for fact in ours["facts"]] == [
            code for code, _ in verdict.facts
        ]
        for name, holds in {
            f"{s.kind}": True, f"{s.kind}, same verdict": said == verdict.verdict,
            f"{s.kind}, same mistakes": same, f"{s.kind}, cannot tell": said == "cannot tell" != verdict.verdict,
            f"{s.kind}, opposite": {said, verdict.verdict} == OPPOSITE,
        }.items():  # fmt: skip
            tally[name] = tally.get(name, 0) + holds
        accused = s.kind == "correct" and said == "wrong"
        if accused or {said, verdict.verdict} == OPPOSITE or not (agrees or free):
            failures.append((s.variant, s, verdict.verdict, verdict.mistakes, ours))
    print(json.dumps(tally, indent=1))
    assert failures == []
