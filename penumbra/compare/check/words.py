# ruff: noqa: E501 (a text a line)
"""What `penumbra check` says, in English: one place, so that a course can translate it.

The texts of the mistakes themselves stand in c_renderer/mistakes/catalogue.def.
"""

from __future__ import annotations

WORDS: dict[str, str] = {
    "right": "RIGHT: the light is computed correctly.",
    "wrong": "WRONG: the light is not computed correctly.",
    "cannot tell": "CANNOT TELL from this whether the light is computed correctly.",
    "confidence": "confidence {confidence}",
    "detectable": "It would have shown a light that is off by {brightness} or more, and noise of "
    "fewer than {samples} of the {n} light samples.",
    "detectable_mean": "It would have shown a light that is off by {brightness} or more.",
    "hidden": "It cannot show: {mistakes}.",
    "right in brightness": "RIGHT, as far as brightness shows: from this nobody can tell whether nbLightSamples works.",
    "settle": "What would settle it: {what}.",
    "more": "To see those too: {what}.",
    "settle_n": "a picture with at least 16 light samples",
    "settle_size": "a larger picture, such as 600 x 400",
    "settle_png": "a PNG instead of a JPEG",
    "settle_scene": "a picture of another scene: penumbra scene scenes/{scene} --as cpp",
    "settle_camera": "the scene's own camera: penumbra scene {scene} --as cpp",
    "power": "your scene has a light of power {power:.4g} where this one has {stated:.4g} (all else "
    "agrees)",
    "power_several": "your lights are {factor:.3f} times as bright as this scene's (all else agrees)",
    "better_sampler": "your noise is that of about {times:.1f} times as many independent samples: your "
    "samples are better spread than random ones",
    "colours": "your {object} has the colour ({colour}), the scene's is ({stated})",
    "jpeg": "saved as JPEG: a PNG would show smaller faults",
    "saturated": "{share:.0%} of the lit pixels are clipped at white, and say nothing",
    "region_bright": "{region} is {ratio:.2f} times too bright",
    "region_dark": "{region} is too dark: {ratio:.2f} of what it should be",
    "region_not_black": "{region} should be black, and has {value:.0f} of 255",
    "farther_more": ", more so far from the light",
    "farther_less": ", less so far from the light",
    "noise_of": "the noise at N = {n} is that of about N = {effective:.2g}",
    "region_lit": "the lit part of the {object}",
    "region_penumbra": "the penumbra on the {object}",
    "region_shadow": "the shadow on the {object}",
    "observed": "Observed:",
    "cause": "Cause:",
    "perhaps": "Perhaps also:",
    "several": "Several faults at once; sure of these:",
    "unknown": "something that is not in the catalogue of mistakes: the light is off by about {loose:.0%} "
    "in a way that none of them explains",
    "unknown_places": "something that is not in the catalogue of mistakes: in some places the light is off in a way that none of them explains",
    "nearest": "the nearest that is known: {title}",
    "free_light": "the samples seem to come from places that are not the light's: {outside:.0%} of the "
    "light comes from beside it",
    "alike": "These pictures cannot tell it from: {titles}.",
    "yours": "yours ",
    "ours": "right ",
    "reread": "Reread: {step} of the handout; docs/estimator.md.",
    "look": "To see it: {look}",
    "exhibit": "In the museum of mistakes: {address}",
    "command": "The right picture beside yours: {command}",
    "runners": "Other explanations:",
    "odds": "{odds} to 1 against: {titles}",
    "picture": "The picture (no fault of the light):",
    "geometry": "the outline of the objects is not this scene's: {miss} pixels differ. Is it the right "
    "scene?",
    "hint": "Look at: {where}.",
    "hint_noise": "how the noise changes when you change nbLightSamples",
    "hint_mean": "how bright the picture is, apart from its noise",
    "once": "{count} of your pictures hold the same random numbers, and count as one",
}
