"""A class whose every submission's maker is known:
`python -m tests.classroom FOLDER --images 300 --programs 30`.

Pictures of correct renderers and of the catalogue's mistakes, as students save them; what students
hand in beside (nothing, a text called .png, half a picture, an archive); and programs, a third of
them hostile.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import textwrap
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.specimens import Specimen

STUDENT = Path(__file__).with_name("student.c")
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
    codes: tuple[str, ...] = ()
    """what a hostile one may be reported as"""


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


# ---------------------------------------------------------------- programs


MUTANTS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    ((), ()),
    (("pdf_times_cos",), ("WEIGHT=(cs / (cl * d * d))",)),
    (("n_no_effect",), ("DRAWN=1",)),
    (("no_shadow",), ("SEEN=1",)),
    ((), ()),
    (("not_divided_by_n",), ("SHARE=1.0",)),
    (("area_omitted",), ("AREA=1.0",)),
    (("only_one_light",), ("ADD==",)),
    (("light_point_fixed",), ("PLACE=s = t = 0.5",)),
)
"""Mistakes, and the macros of student.c that make them"""
HOSTILE: dict[str, tuple[str, tuple[str, ...]]] = {
    "reads_reference": ("""
        for folder in ("/", "/work", "/root", "/home", "..", "../.."):
            for root, folders, files in os.walk(folder):
                folders[:] = [f for f in folders if f not in ("usr", "proc", "sys", "lib", "etc")]
                for file in files:
                    if file.endswith(".exr") or file == "grades.journal":
                        os.write(os.open(out, os.O_CREAT | os.O_WRONLY),
                                 open(os.path.join(root, file), "rb").read())
                        sys.exit()
        """, ("no_image",)),
    "link_out": ('os.symlink("/etc/passwd", out)', ("bad_image",)),
    "fork_bomb": ("while True: os.fork()", ("process_limit",)),
    "endless": ("while True: pass", ("time_limit",)),
    "fills_disk": ("""
        for i in range(100000):
            open(os.path.join(os.path.dirname(out), str(i)), "wb").write(bytes(1 << 20))
        """, ("disk_limit", "file_limit")),
    "prints": ('while True: print("x" * 65536)', ("output_limit",)),
    "memory": ("kept = [bytearray(b'x' * (1 << 28)) for _ in range(400)]", ("memory_limit",)),
    "socket": ("""
        import socket
        socket.create_connection(("127.0.0.1", 80), 5)
        """, ("forbidden", "crashed")),
    "ignores_sigterm": ("""
        import signal
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True: time.sleep(1)
        """, ("time_limit",)),
    "daemon": ("""
        if not os.fork():
            os.setsid()
            if not os.fork():
                time.sleep(3600)
        """, ("no_image", "time_limit")),
}  # fmt: skip
"""Name, the program, and what it may be reported as"""
PRELUDE = "import os, sys, time\nscene, n, seed, out = sys.argv[1:]\n"


def programs(folder: Path, number: int, id_: str = "program{:03d}") -> list[Seat]:
    """number submissions that build a C program, some of which make a mistake."""
    found = []
    for i in range(number):
        truth, macros = MUTANTS[i % len(MUTANTS)]
        home = folder / id_.format(i)
        home.mkdir(parents=True)
        shutil.copy(STUDENT, home / "mine.c")
        flags = " ".join(shlex.quote(f"-D{macro}") for macro in macros)
        build = f"gcc -O2 -fopenmp {flags} -o mine mine.c -ljansson -lm"
        run = "./mine {scene} {light_samples} {seed} {out}"
        _manifest(home, build, run)
        found.append(Seat(home.name, truth))
    return found


def hostile(folder: Path, number: int = len(HOSTILE)) -> list[Seat]:
    """Programs that no renderer is."""
    found = []
    for i in range(number):
        name = list(HOSTILE)[i % len(HOSTILE)]
        home = folder / f"hostile{i:02d}_{name}"
        home.mkdir(parents=True)
        program = textwrap.dedent(HOSTILE[name][0]).strip()
        (home / "attack.py").write_text(PRELUDE + program + "\n")
        _manifest(home, "", "python3 attack.py {scene} {light_samples} {seed} {out}")
        found.append(Seat(home.name, None, HOSTILE[name][1]))
    return found


def _manifest(home: Path, build: str, run: str) -> None:
    lines = ["[program]", *([f"build = {json.dumps(build)}"] if build else [])]
    lines += [f"run = {json.dumps(run)}", 'image_suffix = ".pfm"']
    (home / "penumbra.toml").write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--images", type=int, default=12)
    parser.add_argument("--programs", type=int, default=0, help="a third of them hostile")
    options = parser.parse_args()
    seats = pictures(options.folder, max(options.images - len(BROKEN), 0))
    seats += broken(options.folder, BROKEN[: options.images])
    seats += programs(options.folder, options.programs - options.programs // 3)
    seats += hostile(options.folder, options.programs // 3)
    print(f"{len(seats)} submissions in {options.folder}")


if __name__ == "__main__":
    main()
