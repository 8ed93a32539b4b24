"""The C core in the page: its pixels are the native program's, bit for bit, from file://, in
Chromium and Firefox; requests wait, give way and fail as core.js says.

The page here holds core.js and nothing else of the lesson. What it is held against is compiled by
gcc from the same files, for any processor and without fused products: WebAssembly has none.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

from penumbra.compare.check import mistaken
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.quadrature import Sites
from penumbra.compare.check.view import _sites_at
from penumbra.compare.measure.metrics import REL_MSE_EPSILON
from penumbra.compare.run.library import HEADERS, declarations, load, read_scene
from penumbra.compare.scene import read_scene as read_by_python
from penumbra.course.page import TEMPLATES, asset, packed
from tests import section
from tests.conftest import ROOT, built
from tests.firefox import firefox

WIDTH, HEIGHT = 150, 100
"""Not whole packets of sixteen"""
SCENES = ("tp3", "tp3_sheared", "tp3_disk", "tp3_triangle", "tp3_sphere", "tp3_two_lights")
LOW = {"name": "low", "position": [2, 0, 1], "u": [-4, 0, 0], "v": [0, 0, 4]}
"""A large light, as close to the floor as the sphere's middle"""
SAMPLERS = {"independent": 0, "stratified": 1, "sobol": 2}
ESTIMATORS = {"area": 0, "textbook": 1, "solid-angle": 2, "exact": 3}
SETTINGS = [
    {"estimator": e, "sampler": s} for e in ("area", "textbook", "solid-angle") for s in SAMPLERS
]
SETTINGS += [{"estimator": "exact"}, {"estimator": "area", "samples_per_pixel": 3}]
SETTINGS += [{"estimator": "exact", "samples_per_pixel": 2}]
Evaluate = Callable[[str], Any]


# ---------------------------------------------------------------- the page, in both browsers

HELPERS = """
"use strict";
const base64 = ({ buffer }) => {
  const bytes = new Uint8Array(buffer);
  let text = "";
  for (let i = 0; i < bytes.length; i += 32768) {
    text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  }
  return btoa(text);
};
const cores = {};
const coreOf = (workers) => (cores[workers] ??= Core.open({ workers }));
const reason = (promise) => promise.then(() => "fine", (error) => error.message);
"""


def page_of(**modules: str) -> str:
    """With the content policy of the lesson's page; modules: instead of the real ones."""
    policy = re.search(
        r'<meta http-equiv="Content-Security-Policy"[^>]*>',
        (TEMPLATES / "index.html.j2").read_text(),
    )
    assert policy
    whole = {name: packed(built(f"wasm/{name}.wasm").read_bytes()) for name in ("core", "mistakes")}
    embedded = "".join(
        f'<script type="text/plain" id="{name}-wasm">{text}</script>'
        for name, text in (whole | modules).items()
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8">{policy[0]}<title>t</title>'
        f'<link rel="icon" href="data:,">{embedded}'
        f'<script type="text/plain" id="worker">{asset("worker.js")}</script>'
        f"<script>{HELPERS}{asset('core.js')}</script></html>"
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("core") / "index.html"
    file.write_text(page_of())
    return file


@pytest.fixture(scope="module")
def chromium(page: Path) -> Iterator[Page]:
    """No complaint of the page is left unheard."""
    complaints: list[str] = []
    with section.browser() as browser:
        tab = browser.new_page()
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(page.as_uri())
        yield tab
    assert complaints == []


def asked(evaluate: Evaluate, body: str, workers: int = 2, scene: str = "tp3") -> Any:
    """What the body of an asynchronous function of `core` and `scene` returns."""
    found = json.dumps(scene_of(scene))
    call = f"(async (core, scene) => {{ {body} }})"
    return evaluate(f"coreOf({workers}).then((core) => {call}(core, {found}))")


def frame_in(evaluate: Evaluate, call: str, scene: str, workers: int = 2) -> np.ndarray:
    """(3, H, W) float32 of what a call of the core gives."""
    text = asked(evaluate, f"return base64((await core.{call}).radiance);", workers, scene)
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(3, HEIGHT, WIDTH)


def scene_of(name: str) -> dict[str, Any]:
    base = "tp3" if name == "low" else name
    scene: dict[str, Any] = json.loads((ROOT / "scenes" / f"{base}.json").read_text())
    if name == "low":
        scene["quad_lights"] = [scene["quad_lights"][0] | LOW]
    return scene


@pytest.fixture(scope="module")
def file_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A scene for C's reader."""
    folder = tmp_path_factory.mktemp("scenes")

    def write(name: str) -> Path:
        file = folder / f"{name}.json"
        file.write_text(json.dumps(scene_of(name)))
        return file

    return write


# ---------------------------------------------------------------- the native twins


@cache
def plain() -> tuple[Any, Any]:
    ffi, library = load(built("plain/lib/libpenumbra.so"))
    ffi.cdef(declarations(HEADERS, "float"))
    return ffi, library


def native(file: Path, settings: dict[str, Any]) -> np.ndarray:
    """(3, H, W) float32 by the library that gcc made."""
    ffi, library = plain()
    scene = read_scene(file, ffi, library)
    radiance = np.empty((3, HEIGHT, WIDTH), np.float32)
    chosen = {
        "width": WIDTH,
        "height": HEIGHT,
        "nb_light_samples": settings["nb_light_samples"],
        "samples_per_pixel": settings.get("samples_per_pixel", 1),
        "seed": settings["seed"],
        "threads": 1,
        "sampler": SAMPLERS[settings.get("sampler", "independent")],
        "estimator": ESTIMATORS[settings["estimator"]],
    }
    out = ffi.from_buffer("float[]", radiance)
    assert library.render(
        scene, ffi.new("RenderSettings *", chosen), out, ffi.NULL, ffi.NULL, ffi.NULL
    )
    return radiance


@pytest.fixture
def plain_mistakes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """penumbra.compare.check.mistaken calls the library without fused products."""
    kept = (mistaken.opened, mistaken.choice_id, mistaken.scene_of_c)
    monkeypatch.setattr(mistaken, "LIBRARY", built("plain/lib/libmistakes.so"))
    for function in kept:
        function.cache_clear()
    yield
    for function in kept:
        function.cache_clear()


# ---------------------------------------------------------------- bits


def allowed(name: str, estimator: str) -> tuple[float, float]:
    """What share of the floats may differ, and by how much of the largest. None and nothing, but
    where sines and arcs of the C library decide, whose last bit is each library's own: in a sphere
    light's samples and a triangle's by solid angle; and of the exact image next to the umbra, where
    what is left of a sum is rounding."""
    if (name, estimator) == ("tp3_triangle", "solid-angle"):
        return 0.05, 2.0**-22
    if name == "tp3_sphere":
        return 0.01, 2.0**-23
    return (1e-4, 1e-15) if estimator == "exact" else (0, 0)


def differing(evaluate: Evaluate, file: Path, name: str, counts: tuple[int, ...]) -> list[str]:
    """How a scene's pictures in the page are not the native ones."""
    found = []
    for number, chosen in enumerate(SETTINGS):
        workers = counts[number % len(counts)]
        settings = {"width": WIDTH, "height": HEIGHT, "nb_light_samples": 16, "seed": 7} | chosen
        call = f"render(scene, {json.dumps(settings)})"
        there, here = frame_in(evaluate, call, name, workers), native(file, settings)
        share, worst = (there != here).mean(), np.abs(there - here).max() / here.max()
        most = allowed(name, chosen["estimator"])
        if share > most[0] or worst > most[1] or np.isnan(there).any():
            found.append(f"{chosen}, {workers} workers: {share:.2%} of the floats, {worst}")
    return found


@pytest.mark.parametrize("name", [*SCENES, "low"])
def test_pixels_in_chromium_are_the_native_ones_bit_for_bit(
    name: str, chromium: Page, file_of: Callable[[str], Path]
) -> None:
    """Every sampler and estimator, each by one, two or three workers in turn; `allowed` says what
    little is not."""
    assert not differing(chromium.evaluate, file_of(name), name, (1, 2, 3))


def test_any_number_of_workers_gives_the_same_bits(chromium: Page) -> None:
    """More of them than rows, too."""
    call = f"render(scene, {{ width: {WIDTH}, height: {HEIGHT}, sampler: 'sobol' }})"
    frames = [frame_in(chromium.evaluate, call, "tp3", workers).tobytes() for workers in (1, 2, 3)]
    assert len(set(frames)) == 1
    low = "return base64((await core.render(scene, { width: 9, height: 2 })).radiance);"
    assert asked(chromium.evaluate, low, 1) == asked(chromium.evaluate, low, 3)


MISTAKES = [
    {},
    {"domain": "diagonal"},
    {"visibility": "to_corner"},
    {"visibility": "apart", "average": "divided_by_n_plus_one"},
    {"weight": "pdf_times_cos"},
    {"weight": "cos_of_cos_both", "average": "running_half"},
    {"scale": "area_omitted"},
    {"lights": "only_last_light"},
    {"average": "break_first"},
    {"clamp": "per_light_sample"},
    {"output": "fog_0_02"},
    {"colour": "flat_colour_squared"},
    {"generator": "same_along_rows"},
]


def sites_of(file: Path) -> Sites:
    """What the pixels of a small picture see."""
    scene = read_by_python(file)
    row, column = (a.ravel().astype(float) for a in np.mgrid[0:20, 0:30])
    sites = _sites_at(scene, Grid(scene.camera.fov_y_deg), column, row, 30, 20)
    return sites[sites.receivers.object_id >= 0]


def mistaken_differing(evaluate: Evaluate, file: Path, name: str) -> list[str]:
    """How mistaken pictures and moments in the page are not the native library's."""
    found = []
    for choices in MISTAKES:
        for m, position, divisor in ((1, (0.5, 0.5), 0), (2, (0, 0), 1)):
            settings = {
                "width": WIDTH, "height": HEIGHT, "nb_light_samples": 4, "samples_per_pixel": m,
                "seed": 3, "position_x": position[0], "position_y": position[1], "divisor": divisor,
            }  # fmt: skip
            call = f"mistaken(scene, {json.dumps(choices)}, {json.dumps(settings)})"
            there = frame_in(evaluate, call, name)
            here = mistaken.render(
                file, Variant(**choices), (HEIGHT, WIDTH), 4, m, 3, position, divisor
            )
            if there.tobytes() != here.transpose(2, 0, 1).tobytes():
                apart = (there != here.transpose(2, 0, 1)).sum()
                found.append(f"{choices}, M = {m}: {apart} floats")
    return found


def test_mistaken_pictures_are_the_native_librarys_bit_for_bit(
    chromium: Page, file_of: Callable[[str], Path], plain_mistakes: None
) -> None:
    for name in ("tp3", "tp3_sheared", "tp3_sphere"):
        assert not mistaken_differing(chromium.evaluate, file_of(name), name), name


DOMAINS = ("std", "diagonal", "corner")
RAYS = ["std", "apart", "offset_0_3", "to_corner"]
WEIGHTS = ["std", "pdf_times_cos", "no_light_cosine"]


def moments_in(evaluate: Evaluate, name: str, sites: Sites, domain: str) -> dict[str, np.ndarray]:
    receivers = ", ".join(
        f"{key}: Float64Array.from({json.dumps(values.ravel().tolist())})"
        for key, values in (
            ("point", sites.receivers.point),
            ("normal", sites.receivers.normal),
            ("right", sites.right),
            ("down", sites.down),
        )
    )
    objects = json.dumps(sites.receivers.object_id.tolist())
    body = f"""
      const receivers = {{ {receivers}, object: Int32Array.from({objects}) }};
      const moments = await core.moments(scene, 0, receivers, {json.dumps(domain)},
        {json.dumps(RAYS)}, {json.dumps(WEIGHTS)}, 12);
      return Object.fromEntries(Object.entries(moments).map(([key, a]) => [key, base64(a)]));"""
    text = asked(evaluate, body, scene=name)
    return {key: np.frombuffer(base64.b64decode(v), np.float32) for key, v in text.items()}


@pytest.mark.parametrize("name", ["tp3", "tp3_disk"])
def test_moments_are_the_native_librarys_bit_for_bit(
    name: str, chromium: Page, file_of: Callable[[str], Path], plain_mistakes: None
) -> None:
    """Of more receivers than a worker takes at once, so that the parts' places count."""
    sites = sites_of(file_of(name))
    assert len(sites) > 300
    for domain in DOMAINS:
        there = moments_in(chromium.evaluate, name, sites, domain)
        here = mistaken.moments(file_of(name), 0, sites, domain, RAYS, WEIGHTS, 12)
        for key, values in zip(("chance", "first", "second"), here, strict=True):
            assert there[key].tobytes() == values.tobytes(), (domain, key)


def test_firefox_gives_the_same_bits(
    page: Path, file_of: Callable[[str], Path], plain_mistakes: None
) -> None:
    with firefox() as tab:
        tab.open(page.as_uri())
        for name in ("tp3", "tp3_sphere", "low"):
            assert not differing(tab.evaluate, file_of(name), name, (2,)), name
        assert not mistaken_differing(tab.evaluate, file_of("tp3"), "tp3")
        sites = sites_of(file_of("tp3"))
        there = moments_in(tab.evaluate, "tp3", sites, "std")
        here = mistaken.moments(file_of("tp3"), 0, sites, "std", RAYS, WEIGHTS, 12)
        assert there["second"].tobytes() == here[2].tobytes()


# ---------------------------------------------------------------- what a frame says of itself


def test_shadow_rays_are_those_asked_for(chromium: Page) -> None:
    """N for a quad and one for a point light, M times, from every pixel whose centre shows a
    surface: counted in a picture without anti-aliasing, whose background nothing else equals."""
    shown, *counts = asked(
        chromium.evaluate,
        """
        const size = { width: 60, height: 40, nb_light_samples: 5 };
        const one = await core.render(scene, size), pixels = 60 * 40;
        const many = await core.render(scene, { ...size, samples_per_pixel: 3 });
        const exact = await core.render(scene, { ...size, estimator: "exact" });
        const mistaken = await core.mistaken(scene, {}, size);
        const is = (i) => [0, 1, 2].every((c) => one.radiance[c * pixels + i] === 0.5);
        return [[...Array(pixels).keys()].filter((i) => !is(i)).length, one.shadow_rays,
          many.shadow_rays, exact.shadow_rays, mistaken.shadow_rays];""",
        scene="tp3_two_lights",
    )
    assert 600 < shown < 2400
    assert counts == [shown * 6, shown * 6 * 3, 0, shown * 6]


def test_relative_error_is_the_root_of_rel_mse_over_lit_colours(
    chromium: Page, file_of: Callable[[str], Path]
) -> None:
    found = asked(
        chromium.evaluate,
        f"""
        const size = {{ width: {WIDTH}, height: {HEIGHT}, nb_light_samples: 16, seed: 7 }};
        return relativeError(
          await core.render(scene, size),
          await core.render(scene, {{ ...size, estimator: "exact" }}));""",
    )
    settings = {"nb_light_samples": 16, "seed": 7}
    image, exact = (
        native(file_of("tp3"), settings | {"estimator": e}).astype(float) for e in ("area", "exact")
    )
    lit = (exact > 0) & ~(exact == 0.5).all(axis=0)
    wanted = math.sqrt(np.mean((image - exact)[lit] ** 2 / (exact[lit] ** 2 + REL_MSE_EPSILON)))
    assert found == pytest.approx(wanted, rel=1e-9)


def test_paint_saves_as_the_lab_does(chromium: Page) -> None:
    """Clamped, times 255 in float, truncated: what is below 0, just below 1, above 1, and NaN."""
    values = [-1.0, 0.0, 0.5, 0.99999997, 1.0, 7.0, 3 / 255, 100 / 255]
    painted = asked(
        chromium.evaluate,
        f"""
        const plane = [...{values}, NaN], canvas = document.createElement("canvas");
        const radiance = Float32Array.from([...plane, ...plane, ...plane]);
        paint(canvas, {{ width: 9, height: 1, radiance }});
        return [...canvas.getContext("2d").getImageData(0, 0, 9, 1).data];""",
    )
    levels = (np.clip(np.float32(values), 0, 1) * np.float32(255)).astype(np.uint8)
    wanted = [channel for level in [*levels.tolist(), 0] for channel in (level, level, level, 255)]
    assert painted == wanted


def test_an_unclamped_picture_wraps_when_painted(
    chromium: Page, file_of: Callable[[str], Path], plain_mistakes: None
) -> None:
    """And no other does."""
    size = f"{{ width: {WIDTH}, height: {HEIGHT}, nb_light_samples: 4, seed: 3 }}"
    painted, *wraps = asked(
        chromium.evaluate,
        f"""
        const canvas = document.createElement("canvas");
        const choices = {{ output: "wrap", scale: "light_twice" }};
        const frame = await core.mistaken(scene, choices, {size});
        paint(canvas, frame);
        const {{ data }} = canvas.getContext("2d").getImageData(0, 0, {WIDTH}, {HEIGHT});
        return [base64(data), frame.wraps, (await core.mistaken(scene, {{}}, {size})).wraps,
          (await core.render(scene, {size})).wraps];""",
    )
    image = mistaken.render(
        file_of("tp3"), Variant(output="wrap", scale="light_twice"), (HEIGHT, WIDTH), 4, 1, 3
    )
    levels = np.frombuffer(base64.b64decode(painted), np.uint8).reshape(HEIGHT, WIDTH, 4)
    assert image.max() > 1.1
    assert np.array_equal(levels[..., :3], (image * 255).astype(int) % 256)
    assert wraps == [True, False, False]


# ---------------------------------------------------------------- requests


def test_only_the_newest_waiting_request_of_a_client_is_rendered(chromium: Page) -> None:
    """Twenty moves of a slider at once: the first is under way, the last waits, the others give
    way; another figure's request, and those of nobody, are left alone. A scene that is changed
    while its request waits counts as it was."""
    frames = asked(
        chromium.evaluate,
        """
        const ask = (height, who) => core.render(scene, { width: 60, height }, who), asked = [];
        for (let height = 21; height <= 40; height++) asked.push(ask(height, { client: "slider" }));
        asked.push(ask(41, { client: "other" }), ask(42), ask(43));
        scene.background = [0.25, 0.25, 0.25];
        return (await Promise.all(asked)).map((f) => f && [f.height, f.radiance[0]]);""",
    )
    assert frames[0] == [21, 0.5]
    assert frames[1:19] == [None] * 18
    assert frames[19:] == [[40, 0.5], [41, 0.5], [42, 0.5], [43, 0.5]]


def test_frames_go_before_moments(chromium: Page) -> None:
    """A figure stays alive while a picture is checked."""
    order = asked(
        chromium.evaluate,
        """
        const n = 3000, order = [];
        const up = Float64Array.from({ length: 3 * n }, (_, i) => +(i % 3 === 1));
        const point = up.map((y) => -2 * y), object = new Int32Array(n).fill(1);
        const receivers = { point, normal: up, right: up, down: up, object };
        await Promise.all([
          core.moments(scene, 0, receivers, "std", ["std"], ["std"], 24)
            .then(() => order.push("moments")),
          core.render(scene, { width: 60, height: 40 }).then(() => order.push("frame")),
        ]);
        return order;""",
        workers=1,
    )
    assert order == ["frame", "moments"]


BAD = {
    "{ ...scene, quad_lights: [{ ...quad, u: [0, 0, 0] }] }":
        "quad_lights[0]: u and v span no area",
    "{ ...scene, quad_lights: [{ ...quad, power: NaN }] }": "quad_lights[0].power: not a number",
    "{ ...scene, spheres: [{}] }": "spheres[0].center: not three numbers",
    "{ ...scene, spheres: [{ ...scene.spheres[0], radius: -1 }] }":
        "spheres[0].radius: not above 0",
    "{ ...scene, planes: [{ ...scene.planes[0], normal: [0, 0, 0] }] }":
        "planes[0]: has no direction",
    "{ ...scene, spheres: Array(1001).fill(scene.spheres[0]) }":
        "spheres[1000]: more than 1000 items",
    "{ ...scene, camera: { ...scene.camera, up: [0, 0, 1] } }":
        "camera: up is parallel to the view direction",
    "{ ...scene, camera: undefined }": "camera.position: not three numbers",
    "scene, { sampler: 'worst' }": "sampler: no worst",
    "scene, { estimator: 'toString' }": "estimator: no toString",
    "scene, { width: 0 }": "width: 0 is not a whole number from 1 to 16384",
    "scene, { nb_light_samples: 1.5 }":
        "nb_light_samples: 1.5 is not a whole number from 1 to 1048576",
    "scene, { seed: -1 }": "seed: -1 is not a whole number from 0 to 9007199254740991",
    "scene, { width: 16384, height: 16384 }": "out of memory",
}  # fmt: skip
"""Arguments of core.render, and what it says of them"""
BAD_MISTAKES = {
    "moments(scene, 1, none, 'std', ['std'], ['std'], 24)":
        "light: 1 is not a whole number from 0 to 0",
    "moments(scene, 0, none, 'std', ['std'], ['std'], 25)":
        "grid: 25 is not a whole number from 1 to 24",
    "moments(scene, 0, none, 'std', ['shadow'], ['std'], 4)":
        "visibility: the catalogue has no shadow",
    "mistaken(scene, { weight: 'heavy' })": "weight: the catalogue has no heavy",
    "mistaken(scene, { wait: 'std' })": "wait: not a module of the catalogue",
    "mistaken(scene, {}, { nb_light_samples: 4096 })":
        "nb_light_samples: 4096 is not a whole number from 1 to 4095",
}  # fmt: skip


def test_what_cannot_be_rendered_is_refused_and_harms_nothing(chromium: Page) -> None:
    calls = [*(f"render({call})" for call in BAD), *BAD_MISTAKES]
    *said, nothing, function, same = asked(
        chromium.evaluate,
        f"""
        const quad = scene.quad_lights[0], said = [], size = {{ width: 30, height: 20 }};
        const three = new Float64Array(3), none = {{
          point: three, normal: three, right: three, down: three, object: new Int32Array(1) }};
        const picture = async () => base64((await core.render(scene, size)).radiance);
        const before = await picture();
        {"".join(f"said.push(await reason(core.{call}));" for call in calls)}
        said.push(await reason(core.render()));
        said.push(await reason(core.render(scene, {{ show() {{}} }})));
        return [...said, await picture() === before];""",
    )
    assert said == [*BAD.values(), *BAD_MISTAKES.values()]
    assert "undefined" in nothing and "clone" in function
    assert same is True


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("delete globalThis.WebAssembly", "WebAssembly"),
        ("delete globalThis.Worker", "Worker"),
        ("globalThis.Worker = class { postMessage() { this.onerror({ message: 'blocked' }); } }",
         "blocked"),
    ],
)  # fmt: skip
def test_without_webassembly_or_workers_the_core_says_so(
    missing: str, message: str, chromium: Page, page: Path
) -> None:
    """And the page goes on: no error is left unheard."""
    assert chromium.context.browser
    tab = chromium.context.browser.new_page()
    complaints: list[str] = []
    tab.on("console", lambda said: complaints.append(said.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.add_init_script(missing)
    tab.goto(page.as_uri())
    assert message in tab.evaluate("reason(coreReady)")
    tab.close()
    assert complaints == []


def test_a_damaged_module_is_refused(chromium: Page, tmp_path: Path) -> None:
    file = tmp_path / "index.html"
    file.write_text(page_of(core=packed(b"\0asm\1\0\0\0and nonsense")))
    assert chromium.context.browser
    tab = chromium.context.browser.new_page()
    tab.goto(file.as_uri())
    assert "WebAssembly" in tab.evaluate("reason(coreReady)")
    tab.close()
