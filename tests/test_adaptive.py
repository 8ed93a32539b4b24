"""--target-error: its stated error is honest, and stopping early does not bias the image."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from penumbra.compare.exact.image import exact_image, regions
from penumbra.compare.measure.image import Image
from penumbra.compare.scene import read_scene

Render = Callable[..., Image]
SIZE = {"width": 150, "height": 100}


@pytest.mark.parametrize(
    ("name", "target"), [("tp3", 0.1), ("tp3", 0.02), ("tp3_disk", 0.1), ("tp3_sphere", 0.1)]
)
def test_at_most_5_percent_of_the_pixels_are_above_their_stated_error(
    name: str, target: float, render: Render, scenes: Path
) -> None:
    """|image - exact| <= 2 sqrt(stated variance), grey. Over K = 4 seeds and n object pixels the
    share above it is binomial: 5% and 3 standard errors allowed, in regions of 1,000 pixels."""
    file = scenes / f"{name}.json"
    scene = read_scene(file)
    exact = exact_image(scene, **SIZE)
    above = []
    for seed in range(4):
        image = render(file, target_error=target, light_samples=4096, seed=seed, **SIZE)
        assert image.variance is not None
        stated = 2 * np.sqrt(image.variance).mean(axis=-1)
        error = np.abs(image.radiance - exact.radiance).mean(axis=-1)
        above.append(error > stated + 1e-6 * exact.radiance.mean(axis=-1))
    for region, mask in regions(scene, exact).items():
        if mask.sum() >= 1000:
            share = np.mean([a[mask] for a in above])
            assert share <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / mask.sum() / 4), region


def test_the_mean_is_unbiased(render: Render, scenes: Path) -> None:
    """Over 60 seeds, the mean error of each region over its standard error between seeds is t
    distributed with 59 degrees of freedom: 4.2 allowed (p = 1e-4). Naive stopping (N chosen by the
    samples that are averaged) is off by many of them in the penumbra."""
    scene = read_scene(scenes / "tp3.json")
    exact = exact_image(scene, 60, 40)
    masks = regions(scene, exact)
    errors: dict[str, list[float]] = {name: [] for name in masks}
    for seed in range(60):
        image = render(
            scenes / "tp3.json", target_error=0.1, light_samples=512, seed=seed, width=60, height=40
        )
        for name, mask in masks.items():
            errors[name].append(float((image.radiance - exact.radiance)[mask].mean()))
    for name, values in errors.items():
        if np.ptp(values) > 1e-6:
            z = np.mean(values) / (np.std(values, ddof=1) / np.sqrt(len(values)))
            assert abs(z) < 4.2, name


def test_a_smaller_target_takes_more_samples_where_they_are_needed(
    render: Render, scenes: Path
) -> None:
    spent = []
    for target in (0.2, 0.05, 0.02):
        image = render(scenes / "tp3.json", target_error=target, **SIZE)
        assert image.attributes["targetError"] == pytest.approx(target)
        spent.append(float(image.attributes["meanLightSamples"]))
    assert spent[0] < spent[1] < spent[2] < 16384


def test_it_says_what_it_spent(renderer: Path, scenes: Path, tmp_path: Path) -> None:
    command = [str(renderer), str(scenes / "tp3.json"), "-o", str(tmp_path / "a.exr")]
    command += ["--width", "30", "--height", "20", "--target-error", "0.05"]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert "light samples a pixel" in run.stdout
    assert "below 5%" in run.stdout
    for extra in (["--sampler", "sobol"], ["--pixel-samples", "4"], ["--estimator", "textbook"]):
        refused = subprocess.run([*command, *extra], capture_output=True, text=True, timeout=60)
        assert refused.returncode == 2
        assert "--target-error" in refused.stderr
