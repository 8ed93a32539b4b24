"""An instructor's own tests: the assertions, and what their failures add to pytest's report."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image as PillowImage

import penumbra
import penumbra.assertions  # in sys.modules before pytester remembers what to leave there
from penumbra.__main__ import main
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import Image, write_exr
from penumbra.compare.measure.noise import NoiseError, noise_of_pairs
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import read_scene

pytest_plugins = ["pytester"]

TP3 = ROOT / "scenes" / "tp3.json"
EXAMPLE = ROOT / "docs" / "course-tools" / "pytest" / "test_mine.py"
COUNTS, SEEDS = (4, 8, 16, 32, 64), 4
"""What assert_noise_falls asks for by default"""
IS_INSTALLED = any(one.name == "penumbra" for one in entry_points(group="pytest11"))
PLUGIN = () if IS_INSTALLED else ("-p", "penumbra.plugin")
"""How pytest finds the plug-in: by its entry point, or, where Penumbra was installed before it had
one, by name"""
FLAT = np.full((20, 30, 3), 0.5)


def picture(
    variant: Variant, n: int, seed: int = 5, size: tuple[int, int] = (100, 150)
) -> np.ndarray:
    return render(TP3, variant, size, n, 1, seed)


def save(radiance: np.ndarray, file: Path) -> Path:
    PillowImage.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8)).save(file)
    return file


@pytest.fixture
def student(pytester: pytest.Pytester, renderer: Path) -> pytest.Pytester:
    """A folder with the documented test file and ./mine, a student's program that is right."""
    shutil.copy(EXAMPLE, pytester.path)
    hand_in(pytester.path, Variant())
    command = [renderer, TP3, "-o", pytester.path / "mine.exr", "--light-samples", "256"]
    subprocess.run([*command, "--width", "150", "--height", "100"], check=True, timeout=60)
    return pytester


def hand_in(folder: Path, variant: Variant) -> None:
    """./mine N SEED OUT gives the picture that the variant's renderer makes."""
    (folder / "pictures").mkdir(exist_ok=True)
    jobs = [(64, 1)] + [(n, i * SEEDS + k + 1) for i, n in enumerate(COUNTS) for k in range(SEEDS)]
    for n, seed in jobs:
        save(picture(variant, n, seed), folder / "pictures" / f"{n}_{seed}.png")
    program = folder / "mine"
    program.write_text('#!/bin/sh\nexec cp "pictures/$1_$2.png" "$3"\n')
    program.chmod(0o755)


def test_documented_test_file_passes_a_right_renderer(student: pytest.Pytester) -> None:
    assert len(re.findall(r"\S.*\n", EXAMPLE.read_text())) <= 12
    student.runpytest_inprocess(*PLUGIN).assert_outcomes(passed=3)


def test_failures_say_verdict_picture_command_and_page(student: pytest.Pytester) -> None:
    """And the command, typed as it stands there, shows the same verdict."""
    hand_in(student.path, Variant(average="n_no_effect"))
    result = student.runpytest_inprocess(
        *PLUGIN, "--penumbra-report", "pages", "--junit-xml", "report.xml"
    )
    result.assert_outcomes(passed=1, failed=2)
    # pytest's last summary repeats the failures whole where CI is set, and in one line elsewhere
    text = result.stdout.str().partition(" short test summary info ")[0]
    assert re.search(r"^E +penumbra.assertions.Refuted: WRONG: the light is not", text, re.M)
    assert "the noise at N = 64 is that of about N = 1" in text
    assert "Refuted: the noise does not fall as N^-0.5 with the number N of light samples" in text
    assert text.count("--- penumbra ---") == 2 and text.count("\npicture: mine.png\n") == 2
    assert "assertions.py" not in text.replace("penumbra.assertions", "")  # only their own lines
    pages = sorted(student.path.glob("pages/*.html"))
    assert [page.name for page in pages] == [
        "test_mine.py-test_light_is_right.html",
        "test_mine.py-test_noise_falls_with_the_light_samples.html",
    ]
    assert all(f"page: pages/{page.name}" in text for page in pages)
    assert "WRONG" in pages[0].read_text() and "not computed correctly" in pages[1].read_text()
    (command,) = set(re.findall(r"^command: penumbra (.*)$", text, re.MULTILINE))
    assert main(shlex.split(command)) == 1
    found = ElementTree.parse(student.path / "report.xml").iter("property")
    names = [one.attrib["name"] for one in found]
    assert names == [f"penumbra_{n}" for n in ("verdict", "picture", "command", "page")] * 2


@pytest.mark.parametrize(
    ("missing", "why"),
    [("penumbra.report.check_page", "penumbra.report.check_page"), ("", "too small")],
)
def test_a_page_that_cannot_be_made_fails_no_report(
    missing: str, why: str, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a library of the page's is missing, or the picture tells too little for one."""
    if missing:
        monkeypatch.setitem(sys.modules, missing, None)
    pytester.makepyfile(
        "import numpy, penumbra\n"
        "def test_noise():\n"
        "    penumbra.assert_noise_falls(lambda n, seed: numpy.full((20, 30, 3), 0.5))\n"
    )
    result = pytester.runpytest_inprocess(*PLUGIN, "--penumbra-report", "pages")
    result.assert_outcomes(failed=1)
    result.stdout.re_match_lines_random([f"page: none: .*{why}", "picture: .*n064.png"])


def test_plugin_is_an_entry_point_that_loads_nothing() -> None:
    """It is loaded by every pytest of the environment."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (module,) = project["entry-points"]["pytest11"].values()
    code = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert not {"numpy", "scipy", "jinja2", "penumbra.assertions", "penumbra.compare"} & set(loaded)


def test_assertions_need_no_pytest(tmp_path: Path) -> None:
    save(picture(Variant(scale="area_omitted"), 16), tmp_path / "n016.png")
    code = (
        "import sys; sys.modules['pytest'] = None; import penumbra; "
        "assert 'numpy' not in sys.modules; penumbra.assert_right('n016.png')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    assert "penumbra.assertions.Refuted: WRONG" in done.stderr
    assert "\nto see it: penumbra check n016.png --scene tp3 --html check.html" in done.stderr


# assert_right


def test_right_takes_an_array_and_shows_it_where_it_is_wrong() -> None:
    penumbra.assert_right(picture(Variant(), 16), light_samples=16)
    with pytest.raises(penumbra.Refuted, match="the light's area is missing") as caught:
        penumbra.assert_right(picture(Variant(scale="area_omitted"), 16), light_samples=16)
    shown = caught.value.picture
    assert shown is not None
    assert PillowImage.open(shown).size == (150, 100)
    assert main([*shlex.split(caught.value.command)[1:3], "--light-samples", "16"]) == 1
    shutil.rmtree(shown.parent)


def test_right_gives_away_no_more_than_the_hint(tmp_path: Path) -> None:
    file = save(picture(Variant(scale="area_omitted"), 16), tmp_path / "n016.png")
    with pytest.raises(penumbra.Refuted) as caught:
        penumbra.assert_right(file, hint=0)
    assert "area" not in str(caught.value) and "--hint 0" in caught.value.command


def test_a_picture_too_small_to_tell_by_is_not_right(tmp_path: Path) -> None:
    """A test that cannot tell has shown nothing: it fails, by an exception of its own."""
    file = save(picture(Variant(), 16, size=(40, 60)), tmp_path / "n016.png")
    with pytest.raises(penumbra.CannotTell, match="What would settle it"):
        penumbra.assert_right([file])


def test_what_cannot_be_checked_is_no_assertion(tmp_path: Path) -> None:
    for images, told in ((tmp_path / "no.png", "no.png"), (FLAT.astype(bool), "bool")):
        with pytest.raises(ValueError, match=told):
            penumbra.assert_right(images, light_samples=16)
    with pytest.raises(ValueError, match="scene nowhere: neither a file nor one of"):
        penumbra.assert_right(FLAT, scene="nowhere", light_samples=16)


# assert_agrees


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return exact_image(read_scene(TP3), 150, 100).radiance


def written(file: Path, radiance: np.ndarray) -> Path:
    """With a variance, so that a region of any size can be tested."""
    variance = np.full_like(radiance, 1e-12)
    write_exr(
        file, Image(radiance, variance, {"lightSamples": 64, "sceneHash": read_scene(TP3).hash})
    )
    return file


def test_agreement_is_within_delta(truth: np.ndarray, tmp_path: Path) -> None:
    """A bias of 1% in every region: within 2%, beyond 0.5%."""
    file = written(tmp_path / "mine.exr", 1.01 * truth)
    penumbra.assert_agrees(file, "exact", delta=0.02)
    with pytest.raises(penumbra.Refuted, match=r"differ in “all”: a bias of \+1\.00%") as caught:
        penumbra.assert_agrees(file, written(tmp_path / "right.exr", truth), delta=0.005)
    assert "lit " in str(caught.value)
    assert main(shlex.split(caught.value.command)[1:]) == 1
    assert main([*shlex.split(caught.value.command)[1:-1], "0.02"]) == 0


def test_noise_that_hides_the_bias_is_told_how_much_less_would_do() -> None:
    with pytest.raises(penumbra.CannotTell, match=r"give about \d+ times as many light samples"):
        penumbra.assert_agrees(picture(Variant(), 4), "exact", delta=0.01)


def test_eight_bits_are_told_that_they_are_too_coarse(tmp_path: Path) -> None:
    file = save(picture(Variant(), 256), tmp_path / "mine.png")
    with pytest.raises(penumbra.CannotTell, match="give images of floats"):
        penumbra.assert_agrees(file, "exact", delta=0.01)


# assert_noise_falls


def test_noise_of_a_right_renderer_falls_in_floats_and_in_bytes(tmp_path: Path) -> None:
    """Into one file each time: it is read before the next is rendered."""
    asked = []

    def to_file(n: int, seed: int) -> Path:
        asked.append((n, seed))
        return save(picture(Variant(), n, seed), tmp_path / "mine.png")

    penumbra.assert_noise_falls(to_file)
    assert [n for n, _ in asked] == [n for n in COUNTS for _ in range(SEEDS)]
    assert len({seed for _, seed in asked}) == len(asked)
    penumbra.assert_noise_falls(lambda n, seed: picture(Variant(), n, seed))


@pytest.mark.parametrize("seeds", [4, 5])
def test_noise_falls_as_fast_as_it_does(seeds: int) -> None:
    """Of sigma = N^-s at every pixel the slope is -s, to the interval of 3000 pixels' variance."""

    def rendered(s: float) -> dict[int, list[np.ndarray]]:
        random = np.random.default_rng(7)
        return {
            n: [FLAT + 0.1 * n**-s * random.standard_normal(FLAT.shape) for _ in range(seeds)]
            for n in COUNTS
        }

    for s in (0.5, 0.75):
        penumbra.assert_noise_falls(rendered(s))
    for s in (0.0, 0.25):
        with pytest.raises(penumbra.Refuted, match=f"falls as N\\^-{s:.1f}"):
            penumbra.assert_noise_falls(rendered(s + 0.01))
    with pytest.raises(
        penumbra.CannotTell, match=r"give (seeds=\d+|a wider range)|, or a tolerance"
    ):
        penumbra.assert_noise_falls(rendered(0.5), tolerance=0.0)


def test_a_bias_is_no_noise() -> None:
    """Nor is another pixel grid: what all pictures have in common does not count."""
    random = np.random.default_rng(3)
    wrong = 2 * FLAT + np.linspace(0, 0.3, 30)[None, :, None]
    penumbra.assert_noise_falls(
        lambda n, seed: wrong + 0.1 * n**-0.5 * random.standard_normal(FLAT.shape)
    )


@pytest.mark.parametrize(
    ("render_it", "told"),
    [
        (lambda n, seed: FLAT, "let the random numbers depend on the seed"),
        (lambda n, seed: FLAT + (seed % 2) * 0.1 * (n < 16), "some pictures of one N are the same"),
    ],
)
def test_pictures_that_do_not_depend_on_the_seed_cannot_tell(render_it: object, told: str) -> None:
    with pytest.raises(penumbra.CannotTell, match=told):
        penumbra.assert_noise_falls(render_it)  # type: ignore[arg-type]


def test_noise_below_a_step_of_eight_bits_does_not_count(tmp_path: Path) -> None:
    random = np.random.default_rng(3)

    def to_file(n: int, seed: int) -> Path:
        return save(FLAT + 0.01 / n * random.standard_normal(FLAT.shape), tmp_path / "mine.png")

    with pytest.raises(penumbra.CannotTell, match="8 bits"):
        penumbra.assert_noise_falls(to_file)


def test_clipped_pixels_and_their_neighbours_say_nothing_of_noise() -> None:
    """Of a half that is 1.5 standard deviations below 1, where it is clipped, 43% of the pixels are
    cut in none of four images, and have 0.77 of the variance; counted, they would lower the whole
    by 7%. Their neighbours tell. The tolerance is 5 standard errors of one pair's 3 channels of
    the other half, 4%."""
    random = np.random.default_rng(5)
    height, width = 120, 180
    mean = np.full((height, width, 3), 0.4)
    mean[:, : width // 2] = 0.85
    images = [
        Image(np.clip(mean + 0.1 * random.standard_normal(mean.shape), 0, 1), clipped=True)
        for _ in range(4)
    ]
    squares, _ = noise_of_pairs([images])
    np.testing.assert_allclose(squares, 0.01, rtol=5 * (2 / (3 * height * width / 2)) ** 0.5)


@pytest.mark.parametrize(
    ("images", "told"),
    [
        ([[Image(FLAT)]], "two or more"),
        ([[Image(FLAT), Image(FLAT)], [Image(FLAT)]], "two or more"),
        ([[Image(FLAT), Image(FLAT[:10])]], "30 x 10, 30 x 20"),
        ([[Image(FLAT), Image(FLAT * np.nan)]], "NaN"),
        ([[Image(FLAT * 2, clipped=True)] * 2], "every pixel is clipped"),
    ],
)
def test_images_whose_noise_cannot_be_measured_are_refused(
    images: list[list[Image]], told: str
) -> None:
    with pytest.raises(NoiseError, match=told):
        noise_of_pairs(images)


def test_too_few_pictures_are_refused_before_any_is_rendered() -> None:
    def never(n: int, seed: int) -> np.ndarray:
        raise RuntimeError

    for asked in ({"seeds": 3}, {"light_samples": (4, 16)}):
        with pytest.raises(ValueError, match="three or more numbers of light samples"):
            penumbra.assert_noise_falls(never, **asked)  # type: ignore[arg-type]


def test_nothing_else_is_in_the_package() -> None:
    with pytest.raises(AttributeError, match="no attribute 'assert_wrong'"):
        penumbra.assert_wrong  # noqa: B018
