"""Outputs that are no plain files: devices and pipes are written to, links are followed.

tests/test_outputs.py holds what happens when writing fails or is stopped.
"""

from __future__ import annotations

import json
import os
import re
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.measure.image import Image, ImageError, read_image, write_display, write_exr
from penumbra.compare.run.journal import Journal, JournalError
from penumbra.compare.run.output import named, write_json, write_whole
from tests.conftest import ROOT

RENDER = [str(ROOT / "build" / "bin" / "penumbra-render")]


def render(out: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [*RENDER, "scene.json", "--light-samples", "2", "-o", out]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


def error_of_render(out: str) -> str:
    done = render(out)
    assert done.returncode == (2 if done.stderr else 0) and done.stderr.count("\n") < 2
    return done.stderr.removeprefix("penumbra-render: ").strip()


def error_of(write: Callable[[Path], None]) -> Callable[[str], str]:
    """As the command line would print it."""

    def run(out: str) -> str:
        try:
            write(Path(out))
        except ImageError as error:
            return str(error)
        except OSError as error:
            return f"{error.filename}: cannot be written: {error.strerror}"
        return ""

    return run


WRITERS = {  # name: (out -> error, ending of what it writes)
    "render": (error_of_render, ".exr"),
    "exr": (error_of(lambda out: write_exr(out, Image(np.ones((4, 6, 3))))), ".exr"),
    "picture": (error_of(lambda out: write_display(out, np.ones((4, 6, 3)))), ".png"),
    "json": (error_of(lambda out: write_json(out, {"rows": []})), ".json"),
}
Writer = tuple[Callable[[str], str], str]


@pytest.fixture
def folder(
    make_scene: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The working folder."""
    make_scene(image={"width": 6, "height": 4})
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(params=WRITERS)
def writer(request: pytest.FixtureRequest) -> Writer:
    return WRITERS[request.param]


def is_whole(content: bytes, ending: str, folder: Path) -> bool:
    """Whether its reader takes it."""
    if ending == ".json":
        return "rows" in json.loads(content)
    file = folder / f"read{ending}"
    file.write_bytes(content)
    return read_image(file).shape == (4, 6)


def null_device(folder: Path) -> Path:
    """A device of our own like /dev/null; or that, which only root could destroy."""
    try:
        os.mknod(folder / "null", stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        return Path("/dev/null")
    return folder / "null"


def test_a_device_is_written_to_and_stays_a_device(writer: Writer, folder: Path) -> None:
    device = null_device(folder)
    before = sorted(folder.iterdir())
    assert writer[0](str(device)) == ""
    assert stat.S_ISCHR(device.stat().st_mode)
    assert sorted(folder.iterdir()) == before


def test_a_full_device_is_an_error(writer: Writer, folder: Path) -> None:
    assert writer[0]("/dev/full") == "/dev/full: cannot be written: No space left on device"
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)


def test_a_named_pipe_gets_the_whole_file(writer: Writer, folder: Path) -> None:
    """Of every format, although EXR is written with seeking."""
    write, ending = writer
    pipe = folder / f"pipe{ending}"
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    assert write(str(pipe)) == ""
    reader.join(timeout=30)
    assert is_whole(got[0], ending, folder)
    assert pipe.is_fifo()


PRINT_AND_WRITE = """
from pathlib import Path
from penumbra.compare.run.output import write_json
print("printed")
write_json(Path("/dev/stdout"), {"rows": []})
print("printed later")
"""
SPEAKERS = {  # name: (command, ending, what it prints before and after)
    "json": ([sys.executable, "-c", PRINT_AND_WRITE], ".json", "printed\n", "printed later\n"),
    "render": ([*RENDER, "scene.json", "-o", "/dev/stdout"], ".exr", "", ""),
}


@pytest.mark.parametrize("speaker", SPEAKERS)
@pytest.mark.parametrize("into", ["pipe", "file", "appended"])
def test_standard_output_gets_all_in_order(into: str, speaker: str, folder: Path) -> None:
    """A file to which the shell has redirected it is not replaced under the shell's feet."""
    command, ending, before, after = SPEAKERS[speaker]
    log = folder / "log"
    log.write_text("of an earlier run\n")
    inode = log.stat().st_ino
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    with log.open("ab" if into == "appended" else "wb") as stream:
        output = subprocess.PIPE if into == "pipe" else stream
        done = subprocess.run(command, stdout=output, env=env, check=True, timeout=60)
    content = done.stdout if into == "pipe" else log.read_bytes()
    start = ("of an earlier run\n" if into == "appended" else "") + before
    assert log.stat().st_ino == inode
    assert content.startswith(start.encode()) and content.endswith(after.encode())
    assert is_whole(content[len(start) : len(content) - len(after)], ending, folder)


def test_a_chain_of_links_stays_and_its_end_is_replaced(writer: Writer, folder: Path) -> None:
    """Relative links count from their own folder; the unfinished file lies beside the end."""
    write, ending = writer
    (folder / "far").mkdir()
    first, second, end = folder / f"a{ending}", folder / "far" / "b", folder / "far" / "c"
    first.symlink_to("far/b")
    second.symlink_to("../far/c")
    for content in (None, b"of an earlier run"):  # at first the links dangle
        if content:
            end.write_bytes(content)
        assert write(first.name) == ""
        assert os.readlink(first) == "far/b" and os.readlink(second) == "../far/c"
        assert not end.is_symlink() and is_whole(end.read_bytes(), ending, folder)
        assert sorted(f.name for f in (folder / "far").iterdir()) == ["b", "c"]


@pytest.mark.parametrize(
    ("links", "place", "reason"),
    [
        ({"a": "b", "b": "a"}, "a", "Too many levels of symbolic links"),
        ({"a": "b", "b": "missing/c"}, "missing/c", "No such file or directory"),
    ],
)
def test_links_that_lead_nowhere_are_an_error_that_names_the_place(
    links: dict[str, str], place: str, reason: str, writer: Writer, folder: Path
) -> None:
    """Links in a circle, and into a folder that is not there, which is not made: it may be of a
    disk that is not mounted."""
    write, _ = writer
    for name, target in links.items():
        (folder / name).symlink_to(target)
    before = sorted(folder.iterdir())
    message = write("a")
    assert message.endswith(f"{place}: cannot be written: {reason}"), message
    assert sorted(folder.iterdir()) == before


def test_a_folder_is_no_output(writer: Writer, folder: Path) -> None:
    (folder / "folder").mkdir()
    assert writer[0]("folder") == "folder: cannot be written: Is a directory"
    assert not list((folder / "folder").iterdir())


@pytest.mark.parametrize("name", ["a.png", "a.JPG", "a.Tiff", "a.exr.json", "a.npy", ".csv"])
def test_the_renderer_refuses_a_name_of_another_format(name: str, folder: Path) -> None:
    done = render(name)
    assert done.returncode == 2 and not (folder / name).exists()
    assert f'--output: "{name}" does not end in .exr' in done.stderr
    assert "penumbra png OUT.exr -o OUT.png" in done.stderr


@pytest.mark.parametrize("name", ["a", "a.b", "v1.2", "A.EXR", "a.png/b"])
def test_a_name_that_says_nothing_else_is_taken(name: str, folder: Path) -> None:
    (folder / "a.png").mkdir()
    assert error_of_render(name) == ""
    assert is_whole((folder / name).read_bytes(), ".exr", folder)
    assert named(".exr")(name) == Path(name)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            "exact scene.json -o a.PNG",
            '"a.PNG" does not end in .exr; for a picture of it: penumbra png OUT.exr -o a.PNG',
        ),
        ("png image.exr -o a.exr", '"a.exr" does not end in .png'),
        ("compare a.exr exact --scene scene.json --json a.csv", '"a.csv" does not end in .json'),
        ("speedup scene.json -o a.json", '"a.json" does not end in .csv'),
        ("report -o a.png", '"a.png" does not end in .html'),
    ],
)
def test_every_subcommand_refuses_a_name_of_another_format(
    command: str, message: str, folder: Path
) -> None:
    run = [sys.executable, "-m", "penumbra", *command.split()]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert re.search(rf"argument \S*--\w+: {re.escape(message)}", done.stderr), done.stderr
    assert not (folder / command.split()[-1]).exists()


def test_a_writer_that_fails_leaves_the_device_and_the_link_as_they_were(tmp_path: Path) -> None:
    def fail(part: Path) -> None:
        part.write_text("half")
        raise OSError(28, "No space left on device")

    (tmp_path / "end").write_text("of an earlier run")
    (tmp_path / "link").symlink_to("end")
    os.mkfifo(tmp_path / "pipe")
    before = sorted(tmp_path.iterdir())
    for name in ("link", "pipe"):
        with pytest.raises(OSError, match="No space left on device"):
            write_whole(tmp_path / name, fail)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "link").read_text() == "of an earlier run"


def test_a_journal_must_be_a_plain_file_and_a_link_to_it_stays(tmp_path: Path) -> None:
    """It is read back, which a pipe cannot be."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(JournalError, match="no plain file"):
        Journal(tmp_path / "pipe")
    assert (tmp_path / "pipe").is_fifo()
    (tmp_path / "link").symlink_to("end")
    with Journal(tmp_path / "link") as journal:
        journal.append("a", 1)
        assert (tmp_path / "end").exists()
        journal.delete()
    assert (tmp_path / "link").is_symlink() and not (tmp_path / "end").exists()


@pytest.mark.parametrize(
    "command", ["reference", "speedup", "converge", "trade", "stability", "self-shadow"]
)
def test_what_writes_files_beside_its_output_refuses_a_device(command: str) -> None:
    """As root `/dev/null.json` would appear."""
    scene = [] if command in ("stability", "self-shadow") else [str(ROOT / "scenes" / "tp3.json")]
    ran = subprocess.run(
        [sys.executable, "-m", "penumbra", command, *scene, "-o", "/dev/null"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ran.returncode == 2
    assert '"/dev/null" is a device or a pipe, and files are written beside it' in ran.stderr
