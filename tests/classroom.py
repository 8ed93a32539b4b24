"""A class whose every submission's maker is known: `python -m tests.classroom FOLDER --images 300`.

Pictures of correct renderers and of the catalogue's mistakes, as students save them; and what
students hand in beside: nothing, a text called .png, half a picture, an archive.
"""

from __future__ import annotations

import argparse
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.specimens import Specimen

SMALL = (200, 300)
MISTAKES = (
    ("weight", "pdf_times_cos"), ("average", "n_no_effect"), ("scale", "area_omitted"),
    ("visibility", "to_centre"), ("average", "not_divided_by_n"), ("visibility", "none"),
    ("domain", "diagonal"), ("weight", "no_light_cosine"), ("output", "ambient_0_1"),
    ("visibility", "offset_0_3"), ("average", "break_first"), ("scale", "area_3"),
)  # fmt: skip
"""What a class gets wrong, each of which shows in tp3 at N = 16"""
FILES = ("png", "bmp", "jpg 100", "exr")
COUNTS = (((16, 1),), ((64, 1),), ((1, 1), (16, 1)), ((4, 1), (64, 1)), ((16, 4),))
BROKEN = ("empty", "text", "truncated", "archive", "link", "tiny")


@dataclass(frozen=True)
class Seat:
    """A submission, and what is in it."""

    id: str
    truth: tuple[str, ...] | None
    """the mistakes made; None: nothing that can be judged"""


def seat(folder: Path, id_: str, specimen: Specimen, name: str = "n{n}_m{m}") -> Seat:
    """A submission with a specimen's pictures."""
    home = folder / id_
    home.mkdir(parents=True)
    for file, (n, m) in zip(specimen.files(home), specimen.counts, strict=True):
        file.rename(home / (name.format(n=n, m=m) + file.suffix))
    for told in home.glob("*.json"):
        told.unlink()
    return Seat(id_, specimen.variant.mistakes)


def pictures(folder: Path, number: int, seed: int = 1, id_: str = "student{:03d}") -> list[Seat]:
    """number submissions, a third of them right."""
    rng = np.random.default_rng(seed)
    choices = catalogue().choices
    found = []
    for i in range(number):
        variant = Variant()
        if i % 3:
            variant = variant.replaced(choices[MISTAKES[(i - i // 3) % len(MISTAKES)]])
        plain = Specimen(
            "single", "tp3", ("mistakes",), variant, SMALL,
            COUNTS[i % len(COUNTS)], file=FILES[int(rng.choice(4, p=[0.7, 0.1, 0.1, 0.1]))],
            position=((0.5, 0.5), (0.0, 0.0))[int(rng.integers(2))],
            seed=int(rng.integers(1, 1 << 31)),
        )  # fmt: skip
        if plain.counts[0][1] > 1:
            plain = replace(plain, position=(0.5, 0.5))
        found.append(seat(folder, id_.format(i), plain))
    return found


def broken(folder: Path, kinds: Sequence[str] = BROKEN, id_: str = "broken_{}") -> list[Seat]:
    """Submissions of which nothing, or only a part, can be judged."""
    right = Specimen("correct", "tp3", ("mistakes",), Variant(), SMALL, ((16, 1),), seed=7)
    found = []
    for kind in kinds:
        name = id_.format(kind)
        home = folder / name
        if kind == "link":
            home.symlink_to("/etc")
        elif kind == "archive":
            inner = seat(folder, name, right)
            with zipfile.ZipFile(folder / f"{name}.zip", "w") as archive:
                archive.write(home / "n16_m1.png", "work/n16_m1.png")
            shutil.rmtree(home)
            found.append(Seat(f"{name}.zip", inner.truth))
            continue
        elif kind == "tiny":
            seat(folder, name, replace(right, shape=(20, 30)))
        elif kind == "truncated":
            seat(folder, name, right)
            file = home / "n16_m1.png"
            file.write_bytes(file.read_bytes()[:5000])
        else:
            home.mkdir()
            if kind == "text":
                (home / "n16_m1.png").write_text("I could not make it work, sorry.\n")
        found.append(Seat(name, None))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--images", type=int, default=12)
    options = parser.parse_args()
    seats = pictures(options.folder, max(options.images - len(BROKEN), 0))
    seats += broken(options.folder)[: options.images]
    print(f"{len(seats)} submissions in {options.folder}")


if __name__ == "__main__":
    main()
