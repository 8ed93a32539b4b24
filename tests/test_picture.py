"""What is read from a student's file: values, their law, the background; and what is refused."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from penumbra.compare.check.picture import counts_in_name, read_picture
from penumbra.compare.measure.image import Image as Linear
from penumbra.compare.measure.image import ImageError, write_exr
from penumbra.compare.scene import read_scene

TP3 = read_scene(Path(__file__).resolve().parent.parent / "scenes" / "tp3.json")


def values() -> np.ndarray:
    """(100, 150, 3): the background's 0.5 above, a ramp of red below that leaves [0, 1]."""
    picture = np.full((100, 150, 3), 0.5)
    picture[50:] = 0
    picture[50:, :, 0] = np.linspace(0, 1.5, 150)
    return picture


LAWS = {
    "truncated": lambda v: v * 255,
    "rounded": lambda v: v * 255 + 0.5,
    "gamma 2.2": lambda v: v ** (1 / 2.2) * 255,
    "sRGB": lambda v: (
        np.where(v < 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055) * 255 + 1e-9
    ),
    "square root": lambda v: np.sqrt(v) * 255,
    "gamma twice": lambda v: v ** (1 / 2.2**2) * 255,
}


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".ppm", ".jpg", ".npy"])
@pytest.mark.parametrize("law", LAWS)
def test_the_law_is_read_off_the_background(tmp_path: Path, law: str, suffix: str) -> None:
    levels = LAWS[law](np.clip(values(), 0, 1)).astype(np.uint8)
    file = tmp_path / f"p{suffix}"
    if suffix == ".npy":
        np.save(file, levels)
    else:
        Image.fromarray(levels).save(file, **({"quality": 100} if suffix == ".jpg" else {}))
    picture = read_picture(file, TP3, 16, 1)
    assert picture.law == law
    assert [code for code, _ in picture.facts] == (["transfer"] if law not in LINEAR else [])
    assert picture.jpeg == ("coarse" if suffix == ".jpg" else "")  # Pillow halves the colours
    assert picture.background[:49].all() and not picture.background[51:].any()
    assert picture.clipped[60, 130, 0] and picture.values[60, 130, 0] == 1
    inside = (slice(60, 90), slice(10, 90))
    allowed = 0.06 if suffix == ".jpg" else 0.02 if law not in LINEAR else 0.004
    assert np.abs(picture.values - values())[inside].max() < allowed


LINEAR = ("truncated", "rounded")


def test_floats_are_as_they_are(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", values().astype(np.float32))
    write_exr(tmp_path / "p.exr", Linear(values()))
    for name in ("p.npy", "p.exr"):
        picture = read_picture(tmp_path / name, TP3, 16, 1)
        assert picture.law == "float" and picture.facts == ()
        assert np.array_equal(picture.clipped, values() > 1)
        assert np.allclose(picture.values, np.minimum(values(), 1), atol=1e-6)
        assert picture.background[:50].all() and not picture.background[50:].any()
        assert picture.quantisation_variance == 0
    np.save(tmp_path / "p.npy", np.clip(values(), 0, 1))
    assert read_picture(tmp_path / "p.npy", TP3, 16, 1).clipped[60, 130, 0]


def test_another_background_is_said(tmp_path: Path) -> None:
    levels = (np.clip(values(), 0, 1) * 255).astype(np.uint8)
    levels[:50] = (40, 90, 200)
    Image.fromarray(levels).save(tmp_path / "p.png")
    picture = read_picture(tmp_path / "p.png", TP3, 16, 1)
    assert picture.law == "truncated" and picture.facts[0][0] == "background"
    assert picture.background[:50].all() and not picture.background[50:].any()


def test_grey_noise_of_the_backgrounds_level_is_no_background(tmp_path: Path) -> None:
    levels = (np.clip(values(), 0, 1) * 255).astype(np.uint8)
    grey = np.random.default_rng(1).integers(124, 131, (50, 150, 1))
    levels[50:] = grey
    Image.fromarray(levels).save(tmp_path / "p.png")
    picture = read_picture(tmp_path / "p.png", TP3, 16, 1)
    assert picture.background[:50].all() and picture.background[50:].mean() < 0.01


def test_quantisation_variance_is_that_of_a_step(tmp_path: Path) -> None:
    Image.fromarray((np.clip(values(), 0, 1) * 255).astype(np.uint8)).save(tmp_path / "p.png")
    picture = read_picture(tmp_path / "p.png", TP3, 16, 1)
    assert picture.quantisation_variance == pytest.approx(1 / 12 / 255**2, rel=1e-6)


def test_a_closed_scene_has_no_background(tmp_path: Path) -> None:
    around = replace(TP3.spheres[0], radius=50.0)
    Image.fromarray(np.full((20, 30, 3), 127, np.uint8)).save(tmp_path / "p.png")
    picture = read_picture(tmp_path / "p.png", replace(TP3, spheres=(around,)), 16, 1)
    assert not picture.background.any() and picture.facts == ()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("missing.png", None),
        ("p.png", b"nothing"),
        ("p.txt", b"nothing"),
        ("p.npy", b"nothing"),
        ("p.npy", b""),
        ("p.npy", npy(np.array([{}], dtype=object))),
        ("p.npy", npy(np.zeros((4, 4)))),
        ("p.npy", npy(np.full((4, 4, 3), np.nan))),
        ("p.npy", npy(np.zeros((4, 0, 3)))),
        ("p.npy", npy(np.zeros((4, 4, 3), complex))),
        ("p.npy", npy(np.zeros((40, 40, 3)))[:-7]),
        ("p.npy", npy(np.zeros((4, 4, 3))).replace(b"(4, 4, 3)", b"(9000000, 4000000, 3)")),
    ],
)
def test_refused(tmp_path: Path, name: str, data: bytes | None) -> None:
    file = tmp_path / name
    if data is not None:
        file.write_bytes(data)
    with pytest.raises(ImageError, match=name):
        read_picture(file, TP3, 16, 1)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("n016_aa01.png", (16, 1)),
        ("statement_camera_n064_aa01.png", (64, 1)),
        ("n16_m4.jpg", (16, 4)),
        ("n16m4.jpg", (16, 4)),
        ("tp3_N64.png", (64, None)),
        ("nbLightSamples=16.png", (16, None)),
        ("nb_light_samples_16_pixelSamples_4.png", (16, 4)),
        ("N=16_4spp.png", (16, 4)),
        ("64spp.png", (None, None)),
        ("image.png", (None, None)),
        ("tp3.png", (None, None)),
        ("scene16.png", (None, None)),
        ("cam_m2.png", (None, None)),
        ("n16_n64.png", (None, None)),
        ("n0.png", (None, None)),
        ("n1.5.png", (None, None)),
        ("version2.png", (None, None)),
    ],
)
def test_counts_in_name(name: str, counts: tuple[int | None, int | None]) -> None:
    assert counts_in_name(f"/some/n99/{name}") == counts
