import subprocess

import penumbra


def render(light_samples: int, seed: int) -> str:
    subprocess.run(["./mine", str(light_samples), str(seed), "mine.png"], check=True, timeout=60)
    return "mine.png"


def test_light_is_right() -> None:
    penumbra.assert_right(render(64, 1), scene="tp3", light_samples=64)


def test_noise_falls_with_the_light_samples() -> None:
    penumbra.assert_noise_falls(render, slope=-0.5)


def test_image_agrees_with_the_exact_one() -> None:
    penumbra.assert_agrees("mine.exr", "exact", delta=0.02)
