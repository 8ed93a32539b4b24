# ruff: noqa: E501 (a text a line)
"""What `penumbra check` says, in English: the one place of its words.

The texts of the mistakes themselves stand in c_renderer/mistakes/catalogue.def.
"""

from __future__ import annotations

from penumbra.language import N_, _, say

WORDS: dict[str, str] = {
    "right": N_("RIGHT: the light is computed correctly."),
    "wrong": N_("WRONG: the light is not computed correctly."),
    "cannot tell": N_("CANNOT TELL from this whether the light is computed correctly."),
    "confidence": N_("confidence {share:.1%}"),
    "sure": N_("confidence above 99.9%"),
    "detectable": N_(
        "It would have shown a light that is off by {brightness} or more, and noise of fewer than {samples} of the {n} light samples."
    ),
    "detectable_mean": N_("It would have shown a light that is off by {brightness} or more."),
    "hidden": N_("It cannot show: {mistakes}."),
    "right in brightness": N_(
        "RIGHT, as far as brightness shows: from this nobody can tell whether nbLightSamples works."
    ),
    "settle": N_("What would settle it: {what}."),
    "more": N_("To see those too: {what}."),
    "settle_n": N_("a picture with at least 16 light samples"),
    "settle_size": N_("a larger picture, such as 600 x 400"),
    "settle_png": N_("a PNG instead of a JPEG"),
    "settle_scene": N_("a picture of another scene: penumbra scene scenes/{scene} --as cpp"),
    "settle_camera": N_("the scene's own camera: penumbra scene {scene} --as cpp"),
    "power": N_(
        "your scene has a light of power {power:.4g} where this one has {stated:.4g} (all else agrees)"
    ),
    "power_several": N_(
        "your lights are {factor:.3f} times as bright as this scene's (all else agrees)"
    ),
    "better_sampler": N_(
        "your noise is that of about {times:.1f} times as many independent samples: your samples are better spread than random ones"
    ),
    "colours": N_("the colour {of_object} is ({colour}) in your picture, ({stated}) in the scene"),
    "jpeg": N_("saved as JPEG: a PNG would show smaller faults"),
    "saturated": N_("{share:.0%} of the lit pixels are clipped at white, and say nothing"),
    "region_bright": N_("{region} is {ratio:.2f} times too bright"),
    "region_dark": N_("{region} is too dark: {ratio:.2f} of what it should be"),
    "region_not_black": N_("{region} should be black, and has {value:.0f} of 255"),
    "farther_more": N_(", more so far from the light"),
    "farther_less": N_(", less so far from the light"),
    "noise_of": N_("the noise at N = {n} is that of about N = {effective:.2g}"),
    "region_lit": N_("the lit part {of_object}"),
    "region_penumbra": N_("the penumbra {on_object}"),
    "region_shadow": N_("the shadow {on_object}"),
    "observed": N_("Observed:"),
    "cause": N_("Cause:"),
    "perhaps": N_("Perhaps also:"),
    "several": N_("Several faults at once; sure of these:"),
    "unknown": N_(
        "something that is not in the catalogue of mistakes: the light is off by about {loose:.0%} in a way that none of them explains"
    ),
    "unknown_places": N_(
        "something that is not in the catalogue of mistakes: in some places the light is off in a way that none of them explains"
    ),
    "nearest": N_("the nearest that is known: {title}"),
    "free_light": N_(
        "the samples seem to come from places that are not the light's: {outside:.0%} of the light comes from beside it"
    ),
    "alike": N_("These pictures cannot tell it from: {titles}."),
    "yours": N_("yours"),
    "ours": N_("right"),
    "reread": N_("Reread: {step} of the handout; docs/estimator.md."),
    "look": N_("To see it: {look}"),
    "exhibit": N_("In the museum of mistakes: {address}"),
    "command": N_("The right picture beside yours: {command}"),
    "runners": N_("Other explanations:"),
    "odds": N_("{odds} to 1 against: {titles}"),
    "picture": N_("The picture (no fault of the light):"),
    "geometry": N_(
        "the outline of the objects is not this scene's: {miss} pixels differ. Is it the right scene?"
    ),
    "hint": N_("Look at: {where}."),
    "hint_noise": N_("how the noise changes when you change nbLightSamples"),
    "hint_mean": N_("how bright the picture is, apart from its noise"),
    "once": N_("{count} of your pictures hold the same random numbers, and count as one"),
}
OBJECTS = {
    "floor": (N_("of the floor"), N_("on the floor")),
    "sphere": (N_("of the sphere"), N_("on the sphere")),
    "ball": (N_("of the ball"), N_("on the ball")),
}
"""Those of Penumbra's scenes, as they follow other words: languages have articles and cases"""


def with_object(word: str, name: str, /, **values: str) -> str:
    """WORDS' text of that key, with {of_object} and {on_object} of a scene's object filled.

    >>> with_object("region_lit", "floor"), with_object("region_shadow", "teapot")
    ('the lit part of the floor', 'the shadow on the teapot')
    """
    if name in OBJECTS:
        of_object, on_object = map(_, OBJECTS[name])
    else:
        of_object, on_object = say("of the {name}", name=name), say("on the {name}", name=name)
    return say(WORDS[word], of_object=of_object, on_object=on_object, **values)
