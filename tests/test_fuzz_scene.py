"""Hostile scene files: both readers accept the same, refuse in one line, and never crash.

`make stress` goes on for an hour of CPU where `make test` stops after one round.
"""

from __future__ import annotations

import copy
import json
import re
import resource
import subprocess
import sys
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from tests.campaign import rounds
from tests.conftest import ROOT, built
from tests.test_scene_contract import BASE, c_reader, edited, paths, python_reader, text

CORPUS = sorted((ROOT / "tests" / "fuzz" / "corpus").iterdir())
SCENES = [BASE, *(json.loads(f.read_text()) for f in sorted((ROOT / "scenes").glob("t*.json")))]

NUMBER = st.one_of(
    st.sampled_from(
        [0, -0.0, 1, -1, 1e-9, 9.99e-10, 1e9, -1e9, 1.0000001e9, 1e6, 1e30, 179, 16384]
    ),
    st.sampled_from([float("nan"), float("inf"), 1e-45, 5e-324, 1.8e308, 10**30, 10**30 + 2**46]),
    st.floats(-10, 10),
    st.floats(),
    st.integers(),
)
STRING = st.one_of(
    st.sampled_from(["ball", "lit", "", "é", "a" * 40, "a" * 41, "a\nb", "\x1b[31m", "\x85", "\0"]),
    st.text(st.characters(exclude_categories=()), max_size=8),
)
VALUE = st.one_of(
    NUMBER,
    st.lists(NUMBER, min_size=2, max_size=4),
    st.sampled_from([None, True, [], {}, [[1]], {"name": "a"}]),
    STRING,
)
# Text that no JSON writer would write in the place of a number.
LITERAL = st.one_of(
    st.sampled_from(["NaN", "-Infinity", "1e400", "1e-400", "-0", "01", "1.", ".5", "+1", "0x10"]),
    st.sampled_from(["1_0", "1e5", "1E+0", "9" * 400, "9" * 5000, "0." + "3" * 800, "1e9999", "٣"]),
    st.sampled_from([1, 4, 15, 16, 17, 500, 980, 1000, 2047, 2049, 20000]).map(
        lambda depth: "[" * depth + "]" * depth
    ),
)  # fmt: skip
# Overlong, surrogate, beyond U+10FFFF, cut off, byte order mark; controls; JSON's own signs.
BYTES = st.one_of(
    st.sampled_from([b"\xc0\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80", b"\xe2\x98"]),
    st.sampled_from([b"\xef\xbb\xbf", b"\0", b"\x1b", b"\x7f", b"\xc2\x85", b"\\ud800"]),
    st.sampled_from([b"\r", b"//", b'"', b"{", b"}", b"[", b"]", b",", b":", b"\\", b"\n"]),
    st.binary(max_size=4),
)  # fmt: skip


@st.composite
def scene_files(draw: st.DrawFn) -> bytes:
    """A valid scene after up to three changes of values or keys, two of its text, two of bytes."""
    data = copy.deepcopy(draw(st.sampled_from(SCENES)))
    for _ in range(draw(st.integers(0, 3))):
        change_tree(draw, data)
    content = json.dumps(data, indent=draw(st.sampled_from([None, 1])), ensure_ascii=True)
    for _ in range(draw(st.integers(0, 2))):
        content = change_text(draw, content)
    raw = bytearray(content.encode())
    for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
        place = draw(st.integers(0, len(raw)))
        kind = draw(st.sampled_from(["insert", "replace", "cut", "flip"]))
        if kind == "cut":
            del raw[place:]
        elif kind == "flip" and place < len(raw):
            raw[place] ^= 1 << draw(st.integers(0, 7))
        else:
            inserted = draw(BYTES)
            raw[place : place + len(inserted) * (kind == "replace")] = inserted
    return bytes(raw)


def change_tree(draw: st.DrawFn, data: Any) -> None:
    places = paths(data)
    if not places:
        return
    path = draw(st.sampled_from(places))
    parent = data
    for step in path[:-1]:
        parent = parent[step]
    kind = draw(st.sampled_from(["replace", "replace", "delete", "rename", "add", "repeat"]))
    if kind == "replace":
        parent[path[-1]] = drawn_value(draw)
    elif kind == "delete":
        del parent[path[-1]]
    elif kind == "repeat" and isinstance(parent, list):
        parent.append(copy.deepcopy(parent[path[-1]]))
    elif isinstance(parent, dict):
        key = draw(st.one_of(STRING, st.sampled_from(["name", "power", "u", "radius"])))
        parent[key] = parent.pop(path[-1]) if kind == "rename" else drawn_value(draw)


def drawn_value(draw: st.DrawFn) -> Any:
    """Of our own: the next change may go into it, and sampled_from gives everyone the same."""
    return copy.deepcopy(draw(VALUE))


def change_text(draw: st.DrawFn, content: str) -> str:
    """Another text for a number, or a member of an object twice."""
    if draw(st.booleans()):
        pattern, new = r"-?\d[\d.e+-]*", draw(LITERAL)
    else:
        pattern, new = r'"\w+": [^][{},\n]+', r"\g<0>, \g<0>"
    found = list(re.finditer(pattern, content))
    if not found:
        return content
    match = draw(st.sampled_from(found))
    return content[: match.start()] + match.expand(new) + content[match.end() :]


def expect_agreement(renderer: Path, file: Path) -> None:
    from_c, message = c_reader(renderer, file)
    from_python, python_message = python_reader(file)
    assert from_c == from_python, (message, python_message)
    for said in (message.removesuffix("\n"), python_message):
        assert "Cc" not in map(unicodedata.category, said), said  # control characters
        assert (from_c is None) == (str(file) in said)


def test_readers_agree_on_hostile_scenes(renderer: Path, tmp_path: Path) -> None:
    """700 files a round."""
    file = tmp_path / "scene.json"

    def check(content: bytes) -> None:
        file.write_bytes(content)
        expect_agreement(renderer, file)

    for number in rounds():
        run = given(scene_files())(check)
        run = settings(
            max_examples=700,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )(run)
        seed(number)(run)()


def test_readers_agree_on_what_the_fuzzer_found(tmp_path: Path) -> None:
    """The kept corpus, with the program that ASan and UBSan watch: exit status 0 or 2."""
    renderer = built("asan/bin/penumbra-render")
    accepted = 0
    for file in CORPUS:
        expect_agreement(renderer, file)
        accepted += python_reader(file)[0] is not None
    assert 10 < accepted < len(CORPUS) - 10  # it holds both kinds


def test_scene_reader_keeps_its_promises_on_what_the_fuzzer_found() -> None:
    """Those of tests/fuzz/scene_reader.c: whole scenes, or refusals in one line."""
    command = [str(built("fuzz/bin/scene-reader")), *map(str, CORPUS)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-3000:]
    assert run.stderr.count("Executed ") == len(CORPUS)


@pytest.mark.parametrize(
    "content",
    [
        '{"spheres":[' + "{}," * 340_000 + "{}]}",
        '{"spheres":' + "[" * 900 + "0," * 500_000 + "0" + "]" * 900 + "}",
        '{"a":' * 900 + "{" + ",".join(f'"{i}":0' for i in range(90_000)) + "}" + "}" * 900,
        '{"name":' * 990 + "0" + "}" * 990,
    ],
    ids=["a million faults", "half a million deep values", "deep keys", "deep as the stack"],
)
def test_a_hostile_megabyte_is_refused_in_a_gigabyte(content: str, tmp_path: Path) -> None:
    """These took up to 3.5 GB and 20 s, and the last one ended in a traceback."""
    assert len(content) < 1 << 20
    file = tmp_path / "scene.json"
    file.write_text(content)
    run = subprocess.run(
        [sys.executable, "-m", "penumbra", "scene", str(file)],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30)),
    )
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr.startswith(f"penumbra: {file}:1: ") and run.stderr.count("\n") == 1


def test_an_integer_is_rounded_before_it_is_compared(renderer: Path, tmp_path: Path) -> None:
    """1e30 is 1000000000000000019884624838656 in float64, spaced 2^47 there: as an exact integer
    one more is over the limit of 1e30, as float64 it is the limit."""
    file = tmp_path / "scene.json"
    content = edited("point_lights", 0, "power", to=int(1e30) + 1)
    file.write_text(content.replace("0.9", "1").replace("0.8", "1"))
    expect_agreement(renderer, file)
    assert python_reader(file)[0] is not None


def test_a_key_cannot_write_on_the_terminal(renderer: Path, tmp_path: Path) -> None:
    """An escape sequence, a line's end, a C1 control, and a cut in the middle of a character."""
    for key in ("a\x1b[2Jb", "a\nb", "a\x9bb", "x" + "é" * 500):
        file = tmp_path / "scene.json"
        file.write_text(text(lambda d, key=key: d["camera"].update({key: 1})))
        expect_agreement(renderer, file)
        assert python_reader(file)[0] is None
