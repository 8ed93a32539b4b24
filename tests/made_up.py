"""A class that was made up: grades.json of fictitious students, for what is made from it."""

from __future__ import annotations

import base64
import io
import json
import random
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
from PIL import Image

from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.explanation import headline, observations, text, title
from penumbra.compare.check.verdict import Region, Verdict
from penumbra.compare.check.words import WORDS

RUBRIC = {
    "light_mean": ("The light's mean", 6),
    "penumbra": ("The penumbra", 4),
    "noise_law": ("Noise falls as 1/N", 3),
    "n_has_effect": ("N has an effect", 3),
    "threads": ("Speed-up by threads", 2),
    "other_lights": ("Other lights", 2),
}
"""Title and points of each claim"""
TOTAL = 20
FIRST = (
    "Adèle", "Bastien", "Capucine", "Dorian", "Élise", "Farid", "Gaëlle", "Hugo", "Inès", "Joachim",
    "Khadija", "Léonie", "Maël", "Nour", "Ombline", "Paul", "Quitterie", "Rayan", "Solène", "Théo",
)  # fmt: skip
LAST = (
    "Abadie", "Brunel", "Cazenave", "Delorme", "Estève", "Fabre", "Garnier", "Hamidi", "Izard",
    "Jourdan", "Kessler", "Lacombe", "Marchand", "Navarro", "Ollivier",
)  # fmt: skip
FACT = "the picture is upside down: its first row is the lowest"
PROBLEM = {"code": "time_limit", "text": "It took longer than the 60 s that a picture may take."}

Thumbnail = Callable[[str, str], str]
"""(mistake or "", name of the picture) -> data URI"""


def plain_thumbnail(mistake: str, name: str) -> str:
    """96 x 64: a ball on a floor, as far as a test needs."""
    y, x = np.mgrid[0:64, 0:96]
    ball = (x - 48) ** 2 + (y - 26) ** 2 < 18**2
    pixels = np.where(ball[..., None], (50, 70, 200), (200, 3 * (64 - len(mistake)) % 256, 60))
    stream = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(stream, "JPEG", quality=70)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode()


def grades(submissions: list[dict[str, Any]], hint: int = 1) -> dict[str, Any]:
    """What `penumbra grade` writes of them."""
    made = sorted(submissions, key=lambda s: s["id"])
    by_mistake: dict[str, list[str]] = {}
    for submission in made:
        for name in submission["mistakes"]:
            by_mistake.setdefault(name, []).append(submission["id"])
    counted = sorted(by_mistake.items(), key=lambda item: (-len(item[1]), item[0]))
    return {
        "schema": "penumbra-grades/1",
        "scene": "tp3",
        "hint": hint,
        "trusted": False,
        "rubric": {
            "title": "Soft shadows",
            "total": TOTAL,
            "claims": [{"id": i, "title": t, "points": p} for i, (t, p) in RUBRIC.items()],
        },
        "submissions": made,
        "mistakes": [
            {"name": name, "title": title(name), "submissions": ids} for name, ids in counted
        ],
        "versions": {"penumbra": "0.1.0"},
    }


def submission(
    name: str,
    mistakes: tuple[str, ...] = (),
    hint: int = 1,
    *,
    verdict: str = "",
    failed: bool = False,
    same_as: tuple[str, ...] = (),
    pictures: tuple[str, ...] = ("n016_m1.png", "n064_m1.png"),
    thumbnail: Thumbnail = plain_thumbnail,
) -> dict[str, Any]:
    """verdict: as the mistakes say, unless it is given."""
    word = "cannot tell" if failed else verdict or ("wrong" if mistakes else "right")
    claims = [_claim(claim, word, mistakes, failed, hint) for claim in RUBRIC]
    first = mistakes[0] if mistakes else ""
    why = found(word, mistakes)
    return {
        "id": name,
        "kind": "none" if failed else "images",
        "status": "failed" if failed else "graded",
        "problem": PROBLEM if failed else None,
        "verdict": word,
        "confidence": 0.5 if word == "cannot tell" else 0.9996,
        "headline": PROBLEM["text"] if failed else headline(why),
        "text": PROBLEM["text"] + "\n" if failed else text(why, hint),
        "mistakes": list(mistakes),
        "titles": [title(m) for m in mistakes],
        "perhaps": [],
        "alike": [["no_receiver_cosine"]] if mistakes else [],
        "facts": [] if failed else [FACT],
        "same_as": list(same_as),
        "other_scenes": [],
        "points": sum(c["points"] for c in claims),
        "of": TOTAL,
        "claims": claims,
        "for_instructor": [c["id"] for c in claims if c["state"] == "cannot tell"],
        "pictures": []
        if failed
        else [
            {"name": p, "light_samples": 16, "pixel_samples": 1, "thumbnail": thumbnail(first, p)}
            for p in pictures
        ],
        "evidence": None if failed else evidence(why),
    }


def found(word: str, mistakes: tuple[str, ...]) -> Verdict:
    """As a check would have it: too bright if wrong."""
    wrong = word == "wrong"
    ratio = 1.42 if wrong else 1.0
    return Verdict(
        verdict=word,
        confidence=0.9996,
        mistakes=mistakes,
        perhaps=(),
        several=False,
        alike=(("no_receiver_cosine",),) if wrong else (),
        facts=(("flip_y", FACT),),
        regions=(
            Region("the lit part of the floor", "lit", ratio, 0.001, 1.0, 0.2, 5000),
            Region("the penumbra on the floor", "penumbra", ratio - 0.1 * wrong, 0.005, 1, 0, 900),
        ),
        effective_samples=4.0 if wrong else 16.0,
        detectable_brightness=0.006,
        detectable_samples=12.8,
        runners_up=((("area_halved",), 12.3), (("divided_by_pi",), 3.1e5)) if wrong else (),
        hidden=() if wrong else ("area_by_norms",),
        settle=() if wrong else (WORDS["settle_scene"].format(scene="tp3_sheared.json"),),
        loose=0.05 if "unknown" in mistakes else 0.0,
        beside=0.0,
        variant=Variant(),
        scene="tp3",
        command="penumbra exact scenes/tp3.json -o tp3.exr && penumbra png tp3.exr -o tp3.png",
        nb_light_samples=16,
    )


def evidence(verdict: Verdict) -> dict[str, Any]:
    """As JSON holds it"""
    whole = asdict(verdict) | {"observed": observations(verdict)}
    return json.loads(json.dumps(whole))


def _claim(
    claim: str, word: str, mistakes: tuple[str, ...], failed: bool, hint: int
) -> dict[str, Any]:
    name, of = RUBRIC[claim]
    refuted = {"light_mean", "penumbra"} if mistakes else set()
    if mistakes == ("n_no_effect",):
        refuted = {"noise_law", "n_has_effect"}
    state, why = "shown", f"{name}: as it should be."
    if failed:
        state, why = "missing", PROBLEM["text"]
    elif claim in ("threads", "other_lights") or word == "cannot tell":
        state, why = "cannot tell", "Pictures of one scene cannot show it."
    elif claim in refuted:
        state, why = (
            "refuted",
            "The lit part of the floor is 1.420 times as bright as it should be.",
        )
        if hint >= 2:
            why = f"Your pictures show that {title(mistakes[0])}."
    points = of if state in ("shown", "cannot tell") else 0
    return {"id": claim, "title": name, "state": state, "points": points, "of": of, "why": why}


def students(
    count: int, hint: int = 1, thumbnail: Thumbnail = plain_thumbnail
) -> list[dict[str, Any]]:
    """As classes are: half of it right, a few mistakes common and many rare, some that cannot be
    told or judged. The same students each time."""
    chance = random.Random(20261127)
    names = [f"{last} {first}" for last in LAST for first in FIRST][:count]
    known = sorted(catalogue().mistakes)
    chance.shuffle(known)
    made = []
    for name in names:
        kind = chance.random()
        at = min(int(chance.expovariate(1 / 5)), len(known) - 1)
        mistakes: tuple[str, ...] = (known[at],) if kind < 0.42 else ()
        if kind < 0.03:
            mistakes = known[at], known[(at + 7) % len(known)]
        elif kind < 0.06:
            mistakes = ("unknown",)
        verdict = "cannot tell" if 0.42 <= kind < 0.47 else ""
        made.append(
            submission(name, mistakes, hint, verdict=verdict, failed=0.47 <= kind < 0.5,
                       thumbnail=thumbnail)
        )  # fmt: skip
    return made
