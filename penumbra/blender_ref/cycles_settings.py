"""Every Cycles setting that can move the mean, with the reason for its value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy

Value = bool | int | float | str | None


@dataclass(frozen=True)
class Setting:
    path: str
    """from the scene on, as in Blender's Python console"""
    value: Value
    reason: str
    since: tuple[int, int] = (4, 5)
    """the first Blender that has it"""
    before: tuple[int, int] = (99, 0)
    """the first Blender that has it no more"""


SETTINGS = (
    Setting("render.engine", "CYCLES", "the reference renderer"),
    Setting("cycles.device", "CPU", "the same float arithmetic everywhere"),
    Setting("cycles.feature_set", "SUPPORTED", "nothing experimental", before=(5, 0)),
    Setting("cycles.shading_system", False, "SVM, not OSL"),
    Setting("cycles.debug_bvh_layout", "EMBREE", "the default, named"),
    # Direct light only, as the lab
    Setting("cycles.max_bounces", 0, "direct light only"),
    Setting("cycles.diffuse_bounces", 0, "direct light only"),
    Setting("cycles.glossy_bounces", 0, "direct light only"),
    Setting("cycles.transmission_bounces", 0, "direct light only"),
    Setting("cycles.volume_bounces", 0, "direct light only"),
    Setting("cycles.min_light_bounces", 0, "no Russian roulette to tune"),
    Setting("cycles.min_transparent_bounces", 0, "no Russian roulette to tune"),
    Setting("cycles.use_fast_gi", False, "would add ambient occlusion"),
    Setting("cycles.caustics_reflective", False, "no indirect light"),
    Setting("cycles.caustics_refractive", False, "no indirect light"),
    Setting("cycles.use_guiding", False, "guides indirect light only"),
    # How the lights are sampled
    Setting(
        "cycles.direct_light_sampling_type",
        "NEXT_EVENT_ESTIMATION",
        "with no bounce, multiple importance sampling would lose its BSDF half",
    ),
    Setting("cycles.use_light_tree", False, "lights are drawn independently of the point"),
    Setting("cycles.light_sampling_threshold", 0.0, "weak lights are not skipped at random"),
    Setting("cycles.sampling_pattern", "BLUE_NOISE", "the only one of independent seeds: below"),
    Setting("cycles.scrambling_distance", 1.0, "pixels are not correlated"),
    Setting("cycles.auto_scrambling_distance", False, "pixels are not correlated"),
    Setting("cycles.use_animated_seed", False, "the seed is ours"),
    Setting("cycles.use_sample_subset", False, "parts differ by seed, not by subset"),
    Setting("cycles.sample_offset", 0, "parts differ by seed, not by offset"),
    # Every sample counts the same
    Setting("cycles.use_adaptive_sampling", False, "stopping early biases"),
    Setting("cycles.time_limit", 0.0, "every sample is taken"),
    Setting("cycles.sample_clamp_direct", 0.0, "clamping biases"),
    Setting("cycles.sample_clamp_indirect", 0.0, "clamping biases"),
    Setting("cycles.use_denoising", False, "denoising biases"),
    Setting("cycles.use_layer_samples", "IGNORE", "the scene's sample count holds"),
    Setting("cycles.blur_glossy", 0.0, "no filtering"),
    # The film
    Setting("cycles.use_pixel_jitter", False, "the filter alone moves rays", since=(5, 2)),
    Setting("cycles.film_exposure", 1.0, "radiance as it is"),
    Setting("cycles.rolling_shutter_type", "NONE", "one instant"),
    Setting("cycles.use_auto_tile", False, "one tile"),
    Setting("render.film_transparent", False, "the world is the background"),
    Setting("render.resolution_percentage", 100, "the size asked for"),
    Setting("render.pixel_aspect_x", 1.0, "square pixels"),
    Setting("render.pixel_aspect_y", 1.0, "square pixels"),
    Setting("render.use_border", False, "the whole image"),
    Setting("render.use_motion_blur", False, "nothing moves"),
    Setting("render.use_simplify", False, "nothing is simplified"),
    Setting("render.use_multiview", False, "one eye"),
    Setting("render.use_freestyle", False, "no lines drawn in"),
    Setting("render.use_stamp", False, "no text burnt in"),
    Setting("render.use_compositing", False, "no step after Cycles"),
    Setting("render.use_sequencer", False, "no step after Cycles"),
    Setting("render.use_persistent_data", False, "each part starts anew"),
    Setting("render.threads_mode", "AUTO", "the image is the same for any number"),
    Setting("render.dither_intensity", 0.0, "no noise added"),
    # The file
    Setting("render.image_settings.media_type", "IMAGE", "a single picture", since=(5, 0)),
    Setting("render.image_settings.file_format", "OPEN_EXR", "linear floats"),
    Setting("render.image_settings.color_mode", "RGB", "the background is opaque"),
    Setting("render.image_settings.color_depth", "32", "float32, not half"),
    Setting("render.image_settings.exr_codec", "ZIP", "lossless"),
    Setting("render.use_file_extension", False, "the name asked for"),
    Setting("render.use_overwrite", True, "the name asked for"),
    Setting("render.use_placeholder", False, "the name asked for"),
    # What a screen shows; the EXR is linear whatever these say
    Setting("render.image_settings.color_management", "FOLLOW_SCENE", "no second transform"),
    Setting("display_settings.display_device", "sRGB", "the only one in every configuration"),
    Setting("view_settings.view_transform", "Raw", "the lab saves linear values"),
    Setting("view_settings.look", "None", "the lab saves linear values"),
    Setting("view_settings.exposure", 0.0, "the lab saves linear values"),
    Setting("view_settings.gamma", 1.0, "the lab saves linear values"),
    Setting("view_settings.use_curve_mapping", False, "the lab saves linear values"),
    Setting("view_settings.use_white_balance", False, "the lab saves linear values"),
)


SAMPLER = "blue noise: Owen-scrambled Sobol along a Hilbert curve (Cycles)"
"""Measured on tp3 and a scene of three lights, 16 and 64 samples, 64 seeds. Sobol-Burley: errors
of different seeds correlate, up to 0.87, so that their spread says too little. Tabulated Sobol:
only 256 sets of points, whatever the seed, which leaves a bias (8e-4 of a region at 64 samples)
that no number of seeds averages out. Blue noise: correlation as for independent seeds, bias
within noise, and a third of the variance of a region's mean."""


FILTER_TABLE = 1024
"""Entries of the table by which Cycles turns a random number into a place in the pixel. Its last
entry stays 0 (util_cdf_inverted fills 2 * 511 + 1), so that one sample in 1023 looks somewhere
between the pixel's centre and its left, and one in 1023 its lower, edge."""
CENTRE_OFFSET = 0.25 / (FILTER_TABLE - 1)
"""How far left of and below the centre that leaves the mean place [pixels]: 2.44e-4. Measured on
tp3: 2.5e-4 both ways; with the camera shifted by as much, 1e-6."""


def film_settings(
    width: int, height: int, antialias: bool, transparent_surfaces: int
) -> tuple[Setting, ...]:
    """The settings that depend on the image; the scene has its camera already.

    antialias: uniform places in the pixel (BOX is always one pixel wide, whatever filter_width
    says); else rays within 0.005 pixels of the centre, but for CENTRE_OFFSET.
    """
    pixel_filter: tuple[Setting, ...]
    if antialias:
        offset = 0.0
        pixel_filter = (Setting("cycles.pixel_filter_type", "BOX", "uniform places in the pixel"),)
    else:
        offset = CENTRE_OFFSET / height  # Blender's unit: the image's height
        pixel_filter = (
            Setting("cycles.pixel_filter_type", "BLACKMAN_HARRIS", "has a width"),
            Setting("cycles.filter_width", 0.01, "the least: rays through the pixel's centre"),
        )
    return (
        *pixel_filter,
        Setting("camera.data.shift_x", offset, "undoes CENTRE_OFFSET"),
        Setting("camera.data.shift_y", offset, "undoes CENTRE_OFFSET"),
        Setting("render.resolution_x", width, "the size asked for"),
        Setting("render.resolution_y", height, "the size asked for"),
        Setting(
            "cycles.transparent_max_bounces",
            transparent_surfaces,
            "spheres cut by ray_max_distance; there is nothing else to see through",
        ),
    )


def sample_settings(samples: int, seed: int) -> tuple[Setting, ...]:
    return (
        Setting("cycles.samples", samples, "light samples per pixel"),
        Setting("cycles.seed", seed, "31 bits"),
    )


def apply_settings(scene: bpy.types.Scene, settings: tuple[Setting, ...]) -> dict[str, Value]:
    """Set them all; returns what Blender then holds, by path.

    Raises RuntimeError if Blender does not keep a value.
    """
    held: dict[str, Value] = {}
    for setting in settings:
        if not setting.since <= bpy.app.version[:2] < setting.before:
            continue
        *way, name = setting.path.split(".")
        owner: Any = scene
        for step in way:
            owner = getattr(owner, step)
        setattr(owner, name, setting.value)
        value = getattr(owner, name)
        same = (
            abs(value - setting.value) <= 1e-6 * abs(setting.value)
            if isinstance(setting.value, float)
            else value == setting.value
        )
        if not same:
            raise RuntimeError(f"Blender holds {setting.path} = {value!r}, not {setting.value!r}")
        held[setting.path] = setting.value
    return held
