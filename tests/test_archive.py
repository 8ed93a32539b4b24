"""Archives as students make them, and as nobody should: all or nothing is unpacked, and only below
the folder that it is for."""

from __future__ import annotations

import gzip
import io
import os
import stat
import struct
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from penumbra.grading.archive import ENDINGS, copy_folder, only_folder, unpack
from penumbra.grading.cage import Limits
from penumbra.grading.fault import SubmissionFault

SMALL = Limits(file_size=1 << 20, disk=2 << 20)
FILES = {
    "mine/main.c": b"int main;",
    "mine/run.sh": b"#!/bin/sh\n",
    "mine/img/n016.png": b"\x89PNG",
}


def packed(file: Path, files: dict[str, bytes]) -> Path:
    """An archive of whichever kind the name says."""
    if file.suffix == ".zip":
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(name, data)
        return file
    mode = {"r": "w", "gz": "w:gz", "tgz": "w:gz", "xz": "w:xz", "bz2": "w:bz2"}
    kind = file.name.rsplit(".", 1)[1].replace("txz", "xz").replace("tbz2", "bz2")
    with tarfile.open(file, mode.get(kind, "w")) as archive:  # type: ignore[call-overload]
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return file


def refused(file: Path, limits: Limits = SMALL) -> str:
    """Why an archive is refused; nothing of it must be left, inside or outside of the folder."""
    folder = file.parent / "below" / "unpacked"
    folder.parent.mkdir()
    before = sorted(file.parent.rglob("*"))
    with pytest.raises(SubmissionFault) as said:
        unpack(file, folder, limits)
    assert sorted(file.parent.rglob("*")) == before
    assert said.value.code == "archive" and file.name in said.value.text
    return said.value.text


@pytest.mark.parametrize("ending", ENDINGS)
def test_each_kind_is_unpacked(ending: str, tmp_path: Path) -> None:
    folder = tmp_path / "unpacked"
    unpack(packed(tmp_path / f"dupont{ending}", FILES), folder, SMALL)
    found = {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    assert found == FILES
    assert only_folder(folder) == folder / "mine"
    modes = {f.name: stat.S_IMODE(f.stat().st_mode) for f in folder.rglob("*") if f.is_file()}
    assert modes == {"main.c": 0o644, "run.sh": 0o755, "n016.png": 0o644}


def test_the_time_of_a_file_is_kept_but_not_one_to_come(tmp_path: Path) -> None:
    file = tmp_path / "a.tar"
    with tarfile.open(file, "w") as archive:
        for name, when in (("old", 10**9), ("new", 4 * 10**9)):
            member = tarfile.TarInfo(name)
            member.mtime = when
            archive.addfile(member)
    unpack(file, tmp_path / "a", SMALL)
    assert (tmp_path / "a/old").stat().st_mtime == 10**9
    assert (tmp_path / "a/new").stat().st_mtime < 4 * 10**9


@pytest.mark.parametrize("ending", [".zip", ".tar"])
@pytest.mark.parametrize(
    "name",
    ["/etc/passwd", "../outside", "a/../../outside", "..", "a/..", "\\\\server\\file",
     "..\\..\\outside", "C:\\outside", "C:/outside"],
)  # fmt: skip
def test_names_that_lead_out_are_refused(name: str, ending: str, tmp_path: Path) -> None:
    assert "leads out" in refused(packed(tmp_path / f"a{ending}", {"fine": b"", name: b"x"}))


@pytest.mark.parametrize("ending", [".zip", ".tar"])
@pytest.mark.parametrize("name", ["new\nline", "tab\t", "\x1b[31mred", "\u202eexe.c", "a\x7f"])
def test_names_with_control_characters_are_refused(name: str, ending: str, tmp_path: Path) -> None:
    text = refused(packed(tmp_path / f"a{ending}", {name: b"x"}))
    assert "control characters" in text and text.isprintable()


@pytest.mark.parametrize("name", ["a" * 256, "é" * 128, "/".join("a" * 33), "a/" * 20 + "a" * 300])
def test_names_that_are_too_long_or_deep_are_refused(name: str, tmp_path: Path) -> None:
    text = refused(packed(tmp_path / "a.tar", {name: b"x"}))
    assert "too long a name" in text or "folders in folders" in text


def test_a_name_that_is_no_utf_8_is_taken_as_latin_1(tmp_path: Path) -> None:
    file = tmp_path / "a.tar"
    with tarfile.open(file, "w", encoding="latin-1", format=tarfile.GNU_FORMAT) as archive:
        archive.addfile(tarfile.TarInfo("pénombre.c"))
    unpack(file, tmp_path / "a", SMALL)
    assert [f.name for f in (tmp_path / "a").iterdir()] == ["pénombre.c"]


@pytest.mark.parametrize(
    ("kind", "said"),
    [(tarfile.SYMTYPE, "a link"), (tarfile.LNKTYPE, "a link"), (tarfile.FIFOTYPE, "a device"),
     (tarfile.CHRTYPE, "a device"), (tarfile.BLKTYPE, "a device"), (tarfile.CONTTYPE, "")],
    ids=["link", "hard link", "pipe", "character", "block", "contiguous"],
)  # fmt: skip
def test_what_is_no_plain_file_is_refused(kind: bytes, said: str, tmp_path: Path) -> None:
    file = tmp_path / "a.tar"
    with tarfile.open(file, "w") as archive:
        archive.addfile(tarfile.TarInfo("fine"))
        member = tarfile.TarInfo("strange")
        member.type, member.linkname = kind, "../../outside"
        archive.addfile(member)
    if said:
        assert said in refused(file)
    else:
        unpack(file, tmp_path / "a", SMALL)
        assert (tmp_path / "a/strange").read_bytes() == b""


def test_a_link_in_a_zip_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.zip"
    with zipfile.ZipFile(file, "w") as archive:
        link = zipfile.ZipInfo("link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc")
        archive.writestr("link/passwd", "mine")
    assert "a link" in refused(file)


@pytest.mark.parametrize("ending", [".zip", ".tar"])
@pytest.mark.parametrize("names", [("a", "a"), ("a", "a/b"), ("a/b", "a"), ("a", "./a"), (".",)])
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_of_a_name_are_refused(names: tuple[str, ...], ending: str, tmp_path: Path) -> None:
    file = tmp_path / f"a{ending}"
    if ending == ".zip":
        with zipfile.ZipFile(file, "w") as archive:
            for name in names:
                archive.writestr(name, b"x")
    else:
        with tarfile.open(file, "w") as tar:
            for name in names:
                tar.addfile(tarfile.TarInfo(name))
    assert "two files of that name" in refused(file)


# ---------------------------------------------------------------- too much

ZEROS = bytes(1 << 20)


def many(count: int) -> dict[str, bytes]:
    return {f"zeros{i}": ZEROS for i in range(count)}


@pytest.mark.parametrize("ending", [".zip", ".tar.gz", ".tar.xz", ".tar.bz2", ".tar"])
def test_a_bomb_ends_at_the_limit(ending: str, tmp_path: Path) -> None:
    assert "more than 2 MB in all" in refused(packed(tmp_path / f"a{ending}", many(3)))


def test_a_file_may_be_as_large_as_its_limit_and_no_larger(tmp_path: Path) -> None:
    unpack(packed(tmp_path / "a.zip", {"a": ZEROS}), tmp_path / "a", SMALL)
    assert "more than 1 MB" in refused(packed(tmp_path / "b.zip", {"a": ZEROS + b"0"}))


def test_terabytes_of_zeros_end_at_the_limit_in_little_memory(tmp_path: Path) -> None:
    """A tar that declares one file of 8 TB, of which gzip has 100 MB in 100 kB."""
    member = tarfile.TarInfo("zeros")
    member.size = 8 << 40
    file = tmp_path / "a.tar.gz"
    with gzip.open(file, "wb", 1) as stream:
        stream.write(member.tobuf(tarfile.GNU_FORMAT))
        for _ in range(100):
            stream.write(ZEROS)
    tracemalloc.start()
    assert "more than 1 MB" in refused(file)
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


def test_what_a_zip_declares_is_not_believed(tmp_path: Path) -> None:
    """Ten megabytes that are declared as ten bytes."""
    file = packed(tmp_path / "a.zip", {"a": bytes(10 << 20)})
    size = struct.pack("<I", 10 << 20)
    file.write_bytes(file.read_bytes().replace(size, struct.pack("<I", 10)))
    said = refused(file)
    assert "more than 1 MB" in said or "damaged" in said


def test_files_and_folders_are_counted(tmp_path: Path) -> None:
    folder = tarfile.TarInfo("folder")
    folder.type = tarfile.DIRTYPE
    (tmp_path / "a.tar").write_bytes(folder.tobuf() * 10_001)
    assert "10,000 files and folders" in refused(tmp_path / "a.tar")


def test_a_zip_of_a_hundred_thousand_names_is_not_even_read(tmp_path: Path) -> None:
    file = tmp_path / "a.zip"
    entry = b"PK\1\2" + bytes(42)
    directory = entry * 100_000
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 0xFFFF, 0xFFFF, len(directory), 0, 0)
    file.write_bytes(directory + end)
    assert "10,000 files and folders" in refused(file)
    (tmp_path / "b").mkdir()
    locator = b"PK\6\7" + bytes(16)
    other = tmp_path / "b" / "b.zip"
    other.write_bytes(directory + locator + b"PK\5\6" + bytes(18))
    assert "64-bit" in refused(other)


@pytest.mark.parametrize(
    "kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK]
)
def test_a_long_header_is_not_read(kind: bytes, tmp_path: Path) -> None:
    member = tarfile.TarInfo("long")
    member.type, member.size = kind, 1 << 30
    (tmp_path / "a.tar").write_bytes(member.tobuf() + bytes(1 << 20))
    assert "a header of" in refused(tmp_path / "a.tar")


def test_files_with_holes_are_refused(tmp_path: Path) -> None:
    member = tarfile.TarInfo("old")
    member.type = tarfile.GNUTYPE_SPARSE
    (tmp_path / "a.tar").write_bytes(member.tobuf() + bytes(1024))
    assert "with holes" in refused(tmp_path / "a.tar")
    new = tmp_path / "b" / "b.tar"
    new.parent.mkdir()
    with tarfile.open(new, "w", format=tarfile.PAX_FORMAT) as archive:
        member = tarfile.TarInfo("new")
        member.pax_headers = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0"}
        archive.addfile(member)
    assert "with holes" in refused(new)


# ---------------------------------------------------------------- what cannot be read


def test_an_encrypted_zip_is_told_from_a_damaged_one(tmp_path: Path) -> None:
    file = packed(tmp_path / "a.zip", {"a": b"secret"})
    data = bytearray(file.read_bytes())
    for start, flags in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        data[data.index(start) + flags] |= 1
    file.write_bytes(data)
    assert "encrypted" in refused(file)


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_no_archive_is_said(ending: str, tmp_path: Path) -> None:
    file = tmp_path / f"a{ending}"
    for name, data in {
        "text": b"this is no archive, whatever its name says" * 30,
        "half": packed(file, {"a": os.urandom(50_000)}).read_bytes()[:20_000],
        "nothing": b"",
    }.items():
        own = tmp_path / name / f"a{ending}"
        own.parent.mkdir()
        own.write_bytes(data)
        assert "damaged" in refused(own) or name == "nothing"


@pytest.mark.parametrize("ending", [".zip", ".tar"])
def test_an_empty_archive_is_said(ending: str, tmp_path: Path) -> None:
    assert "no file in it" in refused(packed(tmp_path / f"a{ending}", {}))


def test_an_archive_in_an_archive_stays_one(tmp_path: Path) -> None:
    inner = packed(tmp_path / "inner.zip", many(3)).read_bytes()
    unpack(packed(tmp_path / "a.zip", {"inner.zip": inner}), tmp_path / "a", SMALL)
    assert (tmp_path / "a/inner.zip").read_bytes() == inner


# ---------------------------------------------------------------- folders


def test_a_folder_is_copied_with_its_files_and_nothing_else(tmp_path: Path) -> None:
    source = tmp_path / "dupont"
    (source / "img").mkdir(parents=True)
    (source / "img/n016.png").write_bytes(b"\x89PNG")
    (source / "run.sh").write_text("#!/bin/sh\n")
    (source / "secret.c").write_text("x")
    (source / "secret.c").chmod(0o600)
    (tmp_path / "copy").mkdir()
    copy_folder(source, tmp_path / "copy", SMALL)
    modes = {f.name: oct(stat.S_IMODE(f.stat().st_mode)) for f in (tmp_path / "copy").rglob("*.*")}
    assert modes == {"n016.png": "0o644", "run.sh": "0o755", "secret.c": "0o644"}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda file: file.symlink_to("/etc/passwd"), "a link"),
        (lambda file: file.symlink_to("."), "a link"),
        (os.mkfifo, "no plain file"),
        (lambda file: file.write_bytes(bytes((1 << 20) + 1)), "more than 1 MB"),
    ],
    ids=["link", "loop", "pipe", "large"],
)
def test_what_cannot_be_copied_is_said(
    make: Callable[[Path], object], said: str, tmp_path: Path
) -> None:
    source = tmp_path / "dupont"
    source.mkdir()
    make(source / "file")
    (tmp_path / "copy").mkdir()
    with pytest.raises(SubmissionFault, match=said):
        copy_folder(source, tmp_path / "copy", SMALL)
