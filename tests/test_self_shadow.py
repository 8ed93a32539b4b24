"""Where a shadow ray should start: the study's truth, what each of its four ways does right and
wrong, and that the renderer's own is the fourth."""

from __future__ import annotations

import csv
import doctest
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy import stats

from penumbra.__main__ import main
from penumbra.cli.exit import PASS
from penumbra.compare.exact.image import UMBRA, exact_image
from penumbra.compare.measure.image import Image
from penumbra.compare.run.renderers import MissingProgramError
from penumbra.compare.scene import read_scene
from penumbra.compare.studies import self_shadow
from penumbra.compare.studies.self_shadow import (
    JUDGED,
    NOT_SENT,
    OTHER,
    OWN,
    PRECISIONS,
    SCALES,
    STRATEGIES,
    TRANSLATIONS,
    VISIBLE,
    AimedScene,
    aimed_scenes,
    answers,
    counts,
    proportion_interval,
    self_shadow_map,
    verdict,
    write_map,
)
from penumbra.report import self_shadow as report
from penumbra.report import words
from penumbra.report.figures import rate_colours
from penumbra.report.inputs import ReportError
from penumbra.report.words import digits
from tests import core
from tests.section import assert_french, data_of, rendered_section

RAYS = 1024
BY_NAME = {aimed.name: aimed for aimed in aimed_scenes()}
TRUTH, ROUNDING, FIXED, INTEGER, BOUNDED, SKIP = range(6)
"""Columns of answers()"""
FLOORED = [name for name, aimed in BY_NAME.items() if len(aimed.planes)]


def found(
    name: str, strategy: str, scale: float, translation: float = 0.0, precision: str = "float32"
) -> dict[str, Any]:
    """counts() of one strategy in one scene."""
    judged = answers(BY_NAME[name], precision, translation, scale, RAYS, 1)
    return counts(judged)[JUDGED.index(strategy)]


# ---------------------------------------------------------------- the truth


def exactly(aimed: AimedScene, precision: str, translation: float, scale: float, ray: Any) -> int:
    """The truth about one shadow ray with 60 digits, by other formulas than C's: a segment with
    both ends outside a ball meets it if it comes nearer to the centre than the radius; with one
    end inside, always; with both, never. A plane is met if the ends are on different sides. A
    sphere's inside is left by every segment that ends outside the ball."""
    v = mpmath.matrix
    spheres, planes, quad, camera = (
        a.tolist() for a in aimed.stored(precision, translation, scale)
    )
    ray = ray.tolist()
    o, d = v(camera), v(ray[:3])
    u_edge, v_edge = v(quad[3:6]), v(quad[6:])
    y = v(quad[:3]) + u_edge * ray[3] + v_edge * ray[4]

    def dot(a: Any, b: Any) -> Any:
        return mpmath.fdot(a, b)

    hits = []
    for i, (*center, radius) in enumerate(spheres):
        q = o - v(center)
        a, b, c = dot(d, d), dot(q, d), dot(q, q) - mpmath.mpf(radius) ** 2
        if b * b > a * c:
            hits += [((-b + sign * mpmath.sqrt(b * b - a * c)) / a, i) for sign in (-1, 1)]
    for i, plane in enumerate(planes):
        normal = v(plane[3:])
        if dot(normal, d):
            hits.append((dot(normal, v(plane[:3]) - o) / dot(normal, d), len(spheres) + i))
    distance, own = min(hit for hit in hits if hit[0] > 0)
    x = o + d * distance

    def hides(i: int) -> bool:
        if i >= len(spheres):
            plane = planes[i - len(spheres)]
            normal, foot = v(plane[3:]), v(plane[:3])
            return bool(dot(normal, x - foot) * dot(normal, y - foot) < 0)
        center, radius = v(spheres[i][:3]), spheres[i][3]
        outside = [mpmath.norm(end - center) > radius for end in (x, y)]
        if outside == [True, True]:
            w = y - x
            t = min(max(dot(center - x, w) / dot(w, w), 0), 1)
            return bool(mpmath.norm(x + w * t - center) < radius)
        return outside != [False, False]

    ball = spheres[own] if own < len(spheres) else None
    normal = x - v(ball[:3]) if ball else v(planes[own - len(spheres)][3:])
    from_inside = dot(normal, d) > 0
    if dot(normal * (-1 if from_inside else 1), y - x) <= 0:
        return OWN
    if ball and from_inside and mpmath.norm(y - v(ball[:3])) > ball[3]:
        return OWN
    others = [i for i in range(len(spheres) + len(planes)) if i != own]
    return OTHER if any(hides(i) for i in others) else VISIBLE


@pytest.mark.parametrize(
    "precision, translation, scale",
    [
        ("float32", 0.0, 1.0),
        ("float32", 1e7, 100.0),
        ("float32", 1e3, 0.1),
        ("float64", 0.0, 1e-6),
        ("float64", 1e7, 1e-6),
    ],
)
@pytest.mark.parametrize("name", BY_NAME)
def test_truth_is_that_of_60_digits(
    name: str, precision: str, translation: float, scale: float
) -> None:
    """Of every kind of answer that occurs, and of the rays that some strategy gets wrong, which
    are the delicate ones, a few. The scenes are degenerate enough for mistakes at most places."""
    aimed = BY_NAME[name]
    judged = answers(aimed, precision, translation, scale, RAYS, 2)
    rays = aimed.rays(precision, RAYS, 2)
    sent = np.flatnonzero(judged[:, TRUTH] != NOT_SENT)
    delicate = sent[(judged[sent, 1:] != judged[sent, :1]).any(axis=1)][:6]
    usual = [np.flatnonzero(judged[:, TRUTH] == kind)[:4] for kind in (VISIBLE, OWN, OTHER)]
    chosen = np.unique(np.concatenate([delicate, *usual]))
    assert len(chosen) >= 4
    with mpmath.workdps(60):
        for i in chosen:
            assert exactly(aimed, precision, translation, scale, rays[i]) == judged[i, TRUTH]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("power", [-20, 20])
def test_what_knows_no_length_does_not_see_the_scale(precision: str, power: int) -> None:
    """Times a power of two every product and sum of an untranslated scene scales exactly, so
    the truth, the error bound and skipping answer bit for bit the same. A fixed length does
    not, nor does an offset that is fixed near 0."""
    changed = False
    for aimed in BY_NAME.values():
        one, other = (answers(aimed, precision, 0.0, s, RAYS, 3) for s in (1.0, 2.0**power))
        same = [TRUTH, ROUNDING, BOUNDED, SKIP]
        assert np.array_equal(one[:, same], other[:, same])
        changed |= not np.array_equal(one[:, FIXED], other[:, FIXED])
    assert changed


def test_stored_numbers_are_scaled_translated_and_then_rounded_once() -> None:
    """tp3's ball, centre (0, 0, 3), times 0.1, plus 1e6: float32's step there is 1/16, so 0.3
    becomes 0.3125 and 0.0 stays; the radius is not moved. The light's edges are not either."""
    spheres, planes, quad, camera = BY_NAME["tp3"].stored("float32", 1e6, 0.1)
    assert spheres.tolist() == [[1e6, 1e6, 1e6 + 0.3125, float(np.float32(0.1))]]
    assert planes[0, :3].tolist() == [1e6, 1e6 - 0.1875, 1e6]
    assert planes[0, 3:].tolist() == [0, 1, 0]
    assert quad[3:].tolist() == np.float32([-0.2, 0, 0, 0, 0, 0.2]).tolist()
    assert camera.tolist() == [1e6] * 3


# ---------------------------------------------------------------- the four ways


@pytest.mark.parametrize("precision", PRECISIONS)
def test_fixed_offset_lets_light_through_the_floor_under_a_ball(precision: str) -> None:
    """At scale 1, with the light below the floor, everything above is dark. A ball's point at
    height h < 1e-3 over the floor is moved through it, whatever the precision; the other ways
    know that the crevice is there."""
    row = found("below", "fixed", 1.0, precision=precision)
    assert row["light_leak_low"] > 0.2
    for strategy in ("integer", "bounded", "skip"):
        assert found("below", strategy, 1.0, precision=precision)["light_leak"] == 0


@pytest.mark.parametrize("name", FLOORED)
def test_fixed_offset_removes_every_shadow_of_a_tiny_scene(name: str) -> None:
    """At scale 1e-6 a ray that starts 1e-3 above the floor starts above the whole scene, or
    below, if the surface faces down; balls of 1e-6 are nowhere near."""
    row = found(name, "fixed", 1e-6)
    assert row["hidden"] > 0
    assert row["light_leak"] == row["hidden"]
    assert found(name, "skip", 1e-6)["light_leak"] == 0


def test_fixed_offset_drowns_in_the_rounding_of_a_huge_scene() -> None:
    """At scale 1e6 a float32 coordinate has steps of up to 1/8 or so: 1e-3 is lost, and the
    surface shadows itself. Float64 has room."""
    for name in ("tp3", "small", "inside"):
        assert found(name, "fixed", 1e6)["self_shadow_low"] > 0.1
        assert found(name, "fixed", 1e6, precision="float64")["self_shadow"] == 0


def test_integer_offset_is_right_where_it_was_made_for() -> None:
    """The lab's scene, in metres around the origin: steps of 256 ulp are right there."""
    row = found("tp3", "integer", 1.0)
    assert row["visible"] > 100 and row["hidden"] > 10
    assert row["self_shadow"] == row["light_leak"] == row["other_shadow"] == 0


def test_integer_offset_is_a_fixed_offset_near_the_origin() -> None:
    """Below 1/32 it is 1/65536 m: 15 times a scene of 1e-6, whose shadows all go."""
    row = found("tp3", "integer", 1e-6)
    assert row["light_leak"] == row["hidden"] > 0


def test_integer_offset_grows_with_the_distance_from_the_origin() -> None:
    """256 ulp at 1e4 are 1/4 m: every point of the crevice is moved through the floor. The hit
    itself is off by half an ulp, 1/2000 m, which may be too much only at the very contact."""
    row = found("below", "integer", 1.0, translation=1e4)
    assert row["light_leak"] == row["hidden"] > 0
    assert found("below", "skip", 1.0, translation=1e4)["light_leak_rate"] < 0.05


def test_integer_offset_is_too_small_where_one_coordinate_is_near_zero_and_others_are_not() -> None:
    """In a scene of 1e6, a coordinate may be below 1/32 while the hit's rounding is 1/16: the
    floor through the origin, hit there, shadows itself."""
    assert found("small", "integer", 1e6)["self_shadow"] > 0
    assert found("small", "skip", 1e6)["self_shadow"] == 0


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", BY_NAME)
def test_bounded_offset_never_lets_an_untranslated_surface_shadow_itself(
    name: str, precision: str
) -> None:
    """It is a bound: every error that could put the start behind the surface is in it."""
    for scale in SCALES[::2]:
        assert found(name, "bounded", scale, precision=precision)["self_shadow"] == 0


def test_bounded_offset_leaks_where_rounding_is_as_large_as_the_gap() -> None:
    """At 1e4 float32 has steps of 1/1024: with the light under the floor, points of the hill
    lower than that are moved through it. Skipping leaves them where they are."""
    bounded, skip = (found("grazing", s, 1.0, translation=1e4) for s in ("bounded", "skip"))
    assert bounded["light_leak_low"] > skip["light_leak_high"]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", BY_NAME)
def test_skipping_makes_no_mistake_in_an_untranslated_scene_of_any_scale(
    name: str, precision: str
) -> None:
    """No self-shadow, since the surface is not tested; no leak and no shadow moved, since the
    start is where the hit is. What is left is rounding at a shadow's edge: with about 1e-6 of
    the scene in float32 (1e-3 in the crevice, which is 1e-3 wide, but all dark), 1 ray of
    a million."""
    for scale in SCALES[::2]:
        row = found(name, "skip", scale, precision=precision)
        assert row["sent"] > 50
        assert row["self_shadow"] == row["light_leak"] == row["other_shadow"] == 0


@pytest.mark.parametrize("translation, scale", [(1e2, 1e-2), (1e4, 1.0), (1e6, 1e2)])
@pytest.mark.parametrize("name", BY_NAME)
def test_skipping_shadows_no_surface_by_itself_far_from_the_origin(
    name: str, translation: float, scale: float
) -> None:
    """Nor where coordinates are 1e4 times the scene."""
    row = found(name, "skip", scale, translation)
    assert row["sent"] > 0 and row["self_shadow"] == 0


def test_skipping_wins_on_the_map() -> None:
    """On a coarse map, in both precisions, with no more than a tenth more wrong answers than
    rounding the hit point alone makes: no start could do much better."""
    rows = self_shadow_map(256, (0.0, 1e2, 1e4, 1e6), (1e-6, 1e-3, 1.0, 1e3, 1e6))
    table = {(r["precision"], r["strategy"]): r for r in verdict(rows)}
    for precision in PRECISIONS:
        assert [s for s in STRATEGIES if table[precision, s]["wins"]] == ["skip"]
    skip, rounding = (table["float32", s]["wrong_rate"] for s in ("skip", "rounding"))
    assert skip < 1.1 * rounding


# ---------------------------------------------------------------- the renderer is the fourth

DECLARATIONS = """
Hit scene_hit(const Scene *scene, Ray ray);
bool scene_occluded(const Scene *scene, Ray shadow_ray, real distance, int from);
"""


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("translation, scale", [(0.0, 1.0), (1e4, 1.0), (1e7, 1e3), (0.0, 1e-6)])
@pytest.mark.parametrize("name", BY_NAME)
def test_renderer_answers_as_the_study_says_of_skipping(
    name: str, translation: float, scale: float, precision: str
) -> None:
    """libpenumbra's hit, light sample and occlusion, ray by ray: the study is about the program
    that students run. Both are of one source, but the link-time optimiser may fuse a product in
    the one and not in the other, so where rounding decides, one ray in 200 may differ."""
    aimed = BY_NAME[name]
    judged = answers(aimed, precision, translation, scale, RAYS, 4)
    built = core.core(precision)
    built.ffi.cdef(DECLARATIONS, override=True)
    scene, kept = _core_scene(built, aimed, precision, translation, scale)
    library = built.library
    same = []
    sampler = built.ffi.new("LightSampler *")
    for ray, row in zip(aimed.rays(precision, RAYS, 4).tolist(), judged, strict=True):
        if row[TRUTH] == NOT_SENT:
            continue
        hit = library.scene_hit(scene, {"origin": kept["camera"], "direction": ray[:3]})
        library.light_sampler_create(sampler, scene.lights, hit.point, library.SPREAD_AREA)
        sample = library.light_sampler_draw(sampler, {"x": ray[3], "y": ray[4]})
        shadow_ray = {"origin": hit.point, "direction": sample.direction}
        hidden = library.scene_occluded(scene, shadow_ray, sample.distance, hit.object)
        same.append(hidden == (row[SKIP] != VISIBLE))
    assert len(same) > 50
    assert same.count(False) <= len(same) / 200


def _core_scene(
    built: core.Core, aimed: AimedScene, precision: str, translation: float, scale: float
) -> tuple[Any, dict[str, Any]]:
    """libpenumbra's Scene of the same numbers, and what must outlive it."""
    spheres, planes, quad, camera = aimed.stored(precision, translation, scale)
    u, v = quad[3:6], quad[6:]
    across = np.cross(u, v)
    length = np.sqrt(across @ across)
    light = {
        "corner": quad[:3].tolist(),
        "edge_u": u.tolist(),
        "edge_v": v.tolist(),
        "normal": (across / length).tolist(),
        "area": float(length),
        "radiance": [1, 1, 1],
    }
    new, white = built.ffi.new, [1, 1, 1]
    kept = {
        "spheres": new("Sphere[]", [(s[:3], s[3], white) for s in spheres.tolist()]),
        "planes": new("Plane[]", [(p[:3], p[3:], white) for p in planes.tolist()]),
        "lights": new("Light[]", [(built.library.LIGHT_QUAD, {"quad": light})]),
        "camera": camera.tolist(),
    }
    scene = new(
        "Scene *",
        {
            "ray_max_distance": float("inf"),
            "nb_spheres": len(spheres),
            "nb_planes": len(planes),
            "nb_lights": 1,
            **{k: kept[k] for k in ("spheres", "planes", "lights")},
        },
    )
    return scene, kept


@pytest.mark.parametrize("estimator", ["area", "textbook", "solid-angle"])
@pytest.mark.parametrize("distance", [1e-2, 1e-3, 1e-4])
def test_no_light_leaks_where_a_ball_touches_the_floor(
    distance: float,
    estimator: str,
    render: Callable[..., Image],
    make_scene: Callable[..., Path],
) -> None:
    """The floor under tp3's ball, seen from as close as 1e-4 to where they touch: all umbra. There
    the distance to the ball is lost to rounding, |p - c|^2 - r^2 = 0, and a ray into the ball
    must still meet it."""
    touch = [0.1, -2.0, 3.05]
    camera = {
        "position": [touch[0] + 0.2 * distance, -2 + 0.2 * distance, touch[2] - distance],
        "look_at": touch,
        "up": [0, 1, 0],
        "fov_y_deg": 50,
    }
    ball = {"name": "ball", "center": [0.1, -1, 3.05], "radius": 1, "color": [0, 0, 1]}
    file = make_scene(camera=camera, spheres=[ball])
    assert (exact_image(read_scene(file), 60, 40).shadow == UMBRA).all()
    image = render(file, estimator=estimator, light_samples=16, width=60, height=40)
    assert not image.radiance.any()


# ---------------------------------------------------------------- counting


def test_counts_name_each_mistake() -> None:
    """Six rays, truth first: visible, visible, visible, hidden, hidden, not sent."""
    judged = np.zeros((6, 1 + len(JUDGED)), dtype=np.int8)
    judged[:5, TRUTH] = (VISIBLE, VISIBLE, VISIBLE, OTHER, OWN)
    judged[:5, 1:] = judged[:5, :1]
    judged[:, FIXED] = (OWN, OTHER, VISIBLE, VISIBLE, OTHER, VISIBLE)
    rows = {row["strategy"]: row for row in counts(judged)}
    fixed, skip = rows["fixed"], rows["skip"]
    assert (fixed["sent"], fixed["visible"], fixed["hidden"]) == (5, 3, 2)
    assert (fixed["self_shadow"], fixed["other_shadow"], fixed["light_leak"]) == (1, 1, 1)
    assert fixed["self_shadow_rate"] == 1 / 3 and fixed["light_leak_rate"] == 1 / 2
    assert skip["self_shadow"] == skip["other_shadow"] == skip["light_leak"] == 0


def test_rates_of_nothing_are_unknown() -> None:
    row = counts(np.array([[OTHER, OTHER, OTHER, OTHER, OTHER, OTHER]]))[0]
    assert row["self_shadow_rate"] is row["self_shadow_low"] is None
    assert row["light_leak_rate"] == 0


@pytest.mark.parametrize("successes, trials", [(0, 7), (3, 50), (50, 50), (1, 4096)])
def test_intervals_are_clopper_and_pearsons(successes: int, trials: int) -> None:
    theirs = stats.binomtest(successes, trials).proportion_ci(0.95, method="exact")
    assert proportion_interval(successes, trials) == pytest.approx((theirs.low, theirs.high))


def test_command_writes_a_tidy_table_and_its_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One row for each scene, place, precision and strategy, counts that add up, and the same
    numbers when it is run again."""
    out = tmp_path / "deep" / "map"
    assert main(["self-shadow", "-o", str(out), "--rays", "16"]) == PASS
    assert "skip" in capsys.readouterr().out
    rows = list(csv.DictReader(out.with_suffix(".csv").open()))
    assert list(rows[0]) == list(self_shadow.COLUMNS)
    keys = [tuple(r[k] for k in self_shadow.COLUMNS[:5]) for r in rows]
    assert len(set(keys)) == len(keys)
    place = [r for r in rows if r["precision"] == "float64" and r["scale"] == "1000.0"]
    assert len(place) == len(TRANSLATIONS) * len(JUDGED) * (len(BY_NAME) + 1)
    for row in rows:
        assert int(row["visible"]) + int(row["hidden"]) == int(row["sent"]) <= 16 * len(BY_NAME)
    first = out.with_suffix(".csv").read_bytes()
    write_map(out, 16)
    assert out.with_suffix(".csv").read_bytes() == first
    wins = [v for v in json.loads(out.with_suffix(".json").read_text())["verdict"] if v["wins"]]
    assert {v["precision"] for v in wins} == set(PRECISIONS)


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(self_shadow, "LIBRARY", tmp_path / "libself_shadow.so")
    self_shadow._library.cache_clear()
    with pytest.raises(MissingProgramError, match="make build"):
        answers(BY_NAME["tp3"], "float64", 0.0, 1.0, 1, 1)


# ---------------------------------------------------------------- the report


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A build folder with a small map."""
    folder = tmp_path_factory.mktemp("build")
    write_map(folder / "stability" / "self_shadow", 16)
    return folder


def test_report_does_without_what_was_not_measured(tmp_path: Path) -> None:
    assert rendered_section("self_shadow", tmp_path) is None


def test_report_states_the_verdict_and_draws_the_map(measured: Path) -> None:
    """Every way and every scene is named; the wrong share of skipping is the JSON's."""
    section = report.self_shadow(data_of("self_shadow", measured))
    table = json.loads((measured / "stability" / "self_shadow.json").read_text())["verdict"]
    skip = next(v for v in table if (v["precision"], v["strategy"]) == ("float32", "skip"))
    assert section["skip_wrong"] == digits(100 * skip["wrong_rate"])
    assert [row["title"] for row in section["verdict"] if row["wins"]] == [
        report.TITLES["skip"]
    ] * 2
    shown = rendered_section("self_shadow", measured)
    assert shown is not None
    for text in (*report.TITLES.values(), *report.MISTAKES.values(), *BY_NAME):
        assert text in shown.html
    assert section["svg"].count("<image") >= len(report.TITLES) * len(report.MISTAKES)


def test_the_section_says_nothing_in_english_on_a_french_page(measured: Path) -> None:
    assert_french("self_shadow", measured)


def test_report_refuses_a_broken_map(measured: Path, tmp_path: Path) -> None:
    folder = tmp_path / "stability"
    folder.mkdir()
    text = (measured / "stability" / "self_shadow.json").read_text()
    (folder / "self_shadow.json").write_text(text)
    with pytest.raises(ReportError, match="penumbra self-shadow"):
        rendered_section("self_shadow", tmp_path)
    (folder / "self_shadow.json").write_text(text[:100])
    with pytest.raises(ReportError, match="penumbra self-shadow"):
        rendered_section("self_shadow", tmp_path)


def test_a_rate_is_coloured_by_the_step_that_it_does_not_exceed() -> None:
    """White for 0, the first colour up to 1e-4 itself, and so on, the last for 1."""
    rates = np.array([[[[0.0, 1e-9, 1e-4, 2e-4, 1.0]]]])
    found = rate_colours()[1](rates)
    assert found.ravel().tolist() == [0, 1, 1, 2, 5]


def test_doctests_hold() -> None:
    for module in (self_shadow, report, words):
        tried = doctest.testmod(module)
        assert tried.attempted and not tried.failed
