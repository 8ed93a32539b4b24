"""The page of `penumbra grade` and a sheet a student: what grades.json holds, and nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from penumbra.compare.check.catalogue import catalogue
from penumbra.compare.check.explanation import exhibits, title
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, WRONG
from penumbra.compare.run.output import write_whole
from penumbra.language import N_, _, say
from penumbra.report.build import asset, environment, spoken
from penumbra.report.check_page import NAME, TONES, WHERE
from penumbra.report.words import digits

FAILED = "failed"
"""Said of a submission that could not be judged, in place of a verdict"""
VERDICTS = {WRONG: TONES[WRONG], FAILED: FAILED, CANNOT_TELL: TONES[CANNOT_TELL], RIGHT_: "agrees"}
"""With the tones that mark them, in the column's order: what needs the instructor comes first"""
STATES = {"missing": "missing", "refuted": "differs", "cannot tell": "undecided", "shown": "agrees"}
"""Of claims, the worst first, with the tones that mark them"""
SAID = (N_("right"), N_("wrong"), N_("cannot tell"), N_("failed"), N_("shown"), N_("refuted"),
        N_("missing"))  # fmt: skip
"""Verdicts and states, as people read them"""
KINDS = {"images": N_("pictures"), "program": N_("a program"), "none": N_("nothing")}
PROBLEMS = {
    "time_limit": N_("time limit"),
    "memory_limit": N_("memory limit"),
    "process_limit": N_("process limit"),
    "file_limit": N_("file limit"),
    "disk_limit": N_("disk limit"),
    "output_limit": N_("output limit"),
    "forbidden": N_("forbidden"),
    "crashed": N_("crashed"),
    "no_image": N_("no image"),
    "bad_image": N_("bad image"),
    "build_failed": N_("build failed"),
    "manifest": N_("manifest"),
    "archive": N_("archive"),
    "link": N_("link"),
    "unreadable": N_("unreadable"),
    "too_large": N_("too large"),
    "internal": N_("internal"),
    "killed_worker": N_("killed worker"),
}
"""Codes of why nothing could be judged"""
STATE_ALONE = {
    "cannot tell": N_("What was handed in cannot show it, which costs nothing."),
    "missing": N_("Nothing was handed in that could show it."),
}
"""What a state says of itself, where nothing more is to be told"""
MOST_MISTAKES, MOST_PICTURES, MOST_CLAIMS = 8, 3, 8
"""Mistakes at the top and pictures in a row, above which the others are folded away; claims, above
which the table scrolls by itself"""
MOST_LINES, MOST_PRINTED = 14, 20
"""Lines, to keep a sheet to one page: of text, above which it has two columns; of what a program
printed"""
LONGEST_NAME = 120
"""Of a sheet's file, without its hash [bytes]: file systems allow 255"""
HASHED = re.compile(r"-[0-9a-f]{12}$")
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names that are devices to Windows, where an instructor may unpack the sheets"""
GENERATOR = b'<meta name="generator" content="Penumbra '


def write_class(out: Path, grades: dict[str, Any], course: str = "") -> None:
    """OUT/index.html for the instructor, OUT/sheets/NAME.html for each student, and all of these in
    OUT/sheets.html, to print at once; each one file that needs no network.

    grades: as grades.json has them, "penumbra-grades/1". Sheets say no more than its hint allows:
    of hint 0 points and results only, of others also the text and the reasons, which are at that
    level. course: address of the course's page, if any: the page, and sheets of hint 2 and more,
    link to its museum of mistakes. Sheets of an earlier run go, where no such student is left.
    Raises OSError.
    """
    submissions = grades["submissions"]
    names = file_names([s["id"] for s in submissions])
    sheets = [_sheet(s, grades["hint"], course) for s in submissions]
    shared = {
        "css": Markup("").join(map(asset, ("page.css", "class_page.css"))),
        "rubric": seen(grades["rubric"]),
        "scene": legible(grades["scene"]),
    }
    script = spoken(asset("class_page.js")) + asset("class_page.js")
    templates = environment()
    of_sheets = templates.get_template("class_sheet.html.j2")
    page = templates.get_template("class_page.html.j2")
    for submission, sheet in zip(submissions, sheets, strict=True):
        _write(out / "sheets" / names[submission["id"]], of_sheets.render(shared, sheets=[sheet]))
    _write(out / "sheets.html", of_sheets.render(shared, sheets=sheets))
    content = _content(grades, names, course) | {"script": script, "script_hash": _hash(script)}
    _write(out / "index.html", page.render(shared, **content))
    _remove_others(out / "sheets", set(names.values()))


def _write(file: Path, html: str) -> None:
    write_whole(file, lambda part: part.write_text(html, encoding="utf-8"))


def _hash(script: str) -> str:
    """As a content security policy names the one script that may run."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _remove_others(folder: Path, names: set[str]) -> None:
    """Of the files that were made here; others stay."""
    for file in folder.glob("*.html"):
        if file.name in names or not file.is_file():
            continue
        with file.open("rb") as stream:
            own = GENERATOR in stream.read(1024)
        if own:
            file.unlink()


# Names that students chose


def file_names(ids: Sequence[str]) -> dict[str, str]:
    """A sheet's file for each: its letters, digits, dots and dashes; a hash of the id tells those
    apart that come to the same name (on any file system: case does not tell).

    >>> file_names(["dupont", "José P"])
    {'dupont': 'dupont.html', 'José P': 'José_P.html'}
    >>> sorted(file_names(["../a", "A"]).values())
    ['A-559aead08264.html', 'a-61b4c98bfb92.html']
    """
    short = {name: _short(name) for name in ids}
    count = Counter(text.casefold() for text in short.values())
    return {name: _told_apart(name, text, count) + ".html" for name, text in short.items()}


def _short(name: str) -> str:
    kept = re.sub(r"[^\w.-]+", "_", unicodedata.normalize("NFKC", name))
    short = kept.encode()[:LONGEST_NAME].decode(errors="ignore").strip("._-") or "submission"
    return "_" + short if RESERVED.match(short) else short


def _told_apart(name: str, short: str, count: Counter[str]) -> str:
    if count[short.casefold()] == 1 and not HASHED.search(short):
        return short
    return f"{short}-{hashlib.sha256(name.encode(errors='surrogatepass')).hexdigest()[:12]}"


def legible(text: str) -> str:
    """With its code for each character that cannot be seen, or that turns the others round.

    >>> legible("Zoë"), legible("a\\nb"), legible("exe.\\u202egnp")
    ('Zoë', 'a⟨U+000A⟩b', 'exe.⟨U+202E⟩gnp')
    """
    if text.isprintable():
        return text
    hidden = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return "".join(f"⟨U+{ord(c):04X}⟩" if unicodedata.category(c) in hidden else c for c in text)


def seen(value: Any) -> Any:
    """JSON with each of its texts legible."""
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, list):
        return [seen(item) for item in value]
    return {k: seen(v) for k, v in value.items()} if isinstance(value, dict) else value


# The sheets


def _sheet(submission: dict[str, Any], hint: int, course: str) -> dict[str, Any]:
    """Of a submission, what its student may read."""
    failed = submission["status"] == FAILED
    clean = seen(submission)
    said = [] if failed else _paragraphs(submission["text"])
    return {
        "id": clean["id"],
        "tone": VERDICTS[_verdict(clean)],
        "headline": clean["problem"]["text"] if failed else said[0][0]["text"],
        "printed": _printed(submission, MOST_PRINTED),
        "said": said[1:] if hint >= WHERE else [],
        "exhibits": _exhibits(clean, course) if hint >= NAME else [],
        "long": sum(map(len, said)) > MOST_LINES,
        "points": clean["points"],
        "of": clean["of"],
        "claims": [_claim(claim, hint >= WHERE, clean["headline"]) for claim in clean["claims"]],
        "pictures": [_picture(picture) for picture in clean["pictures"]],
    }


def _exhibits(submission: dict[str, Any], course: str) -> list[dict[str, str]]:
    """What its mistakes are called, with the address of each in the museum of mistakes."""
    shown = exhibits(submission["mistakes"], course) if course else {}
    return [{"title": title(name), "address": address} for name, address in shown.items()]


def _verdict(submission: dict[str, Any]) -> str:
    return FAILED if submission["status"] == FAILED else submission["verdict"]


def _printed(submission: dict[str, Any], most: int | None = None) -> str:
    """The last lines of what a program printed that came to grief"""
    lines = (submission["problem"] or {}).get("printed", "").rstrip("\n").split("\n")
    return "\n".join(map(legible, lines if most is None else lines[-most:]))


def _paragraphs(text: str) -> list[list[dict[str, Any]]]:
    """What `penumbra check` prints: paragraphs of lines, each with how far it is indented."""
    return [
        [
            {"text": legible(line.strip()), "depth": (len(line) - len(line.lstrip(" "))) // 2}
            for line in block.split("\n")
        ]
        for block in re.split(r"\n{2,}", text.strip("\n"))
    ]


def _claim(claim: dict[str, Any], told: bool, headline: str) -> dict[str, Any]:
    """told: whether its reason may be; one that only says the headline again is not."""
    state = claim["state"]
    why = claim["why"] if told else _(STATE_ALONE.get(state, ""))
    return {
        "title": claim["title"],
        "state": state,
        "tone": STATES[state],
        "points": claim["points"],
        "of": claim["of"],
        "why": "" if why == headline else why,
        "order": list(STATES).index(state),
    }


def _picture(picture: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": picture["name"],
        "n": picture["light_samples"],
        "m": picture["pixel_samples"],
        "thumbnail": picture["thumbnail"],
    }


# The page


def _content(grades: dict[str, Any], names: dict[str, str], course: str) -> dict[str, Any]:
    """names: of the sheets' files, by id"""
    claims = [claim["id"] for claim in grades["rubric"]["claims"]]
    rows = [_row(i, s, claims, names[s["id"]], course) for i, s in enumerate(grades["submissions"])]
    anchors = {s["id"]: row for s, row in zip(grades["submissions"], rows, strict=True)}
    counts = Counter(row["verdict"] for row in rows)
    most = max((len(m["submissions"]) for m in grades["mistakes"]), default=1)
    mistakes = [
        {
            "name": m["name"],
            "title": _title(m["name"], m["title"]),
            "count": len(m["submissions"]),
            "share": f"{100 * len(m['submissions']) / most:.1f}",
        }
        for m in grades["mistakes"]
    ]
    return {
        "rows": rows,
        "verdicts": [{"word": w, "tone": VERDICTS[w], "count": counts[w]} for w in VERDICTS],
        "mistakes": mistakes,
        "unfolded": MOST_MISTAKES,
        "failed": [row for row in rows if row["verdict"] == FAILED],
        "undecided": _undecided(grades["rubric"]["claims"], rows),
        "alike": [[anchors[i] for i in same] for same in _same(grades["submissions"])],
        "wide": len(grades["rubric"]["claims"]) > MOST_CLAIMS,
        "hint": grades["hint"],
        "trusted": grades["trusted"],
        "versions": grades["versions"],
    }


def _undecided(
    claims: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Claims that cannot be told of some that were judged; those of the same ones together"""
    judged = [row for row in rows if row["verdict"] != FAILED]
    groups: dict[tuple[str, ...], list[str]] = {}
    for claim in claims:
        found = tuple(row["anchor"] for row in judged if claim["id"] in row["undecided"])
        groups.setdefault(found, []).append(legible(claim["title"]))
    by_anchor = {row["anchor"]: row for row in rows}
    return [
        {"titles": titles, "rows": [by_anchor[anchor] for anchor in found]}
        for found, titles in groups.items()
        if found
    ]


def _same(submissions: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Ids of those that handed in the very same bytes, together; nothing at all is no such thing"""
    some = (s for s in submissions if s["same_as"] and s["kind"] != "none")
    return list(dict.fromkeys(tuple(sorted([s["id"], *s["same_as"]])) for s in some))


def _row(
    place: int, submission: dict[str, Any], claims: Sequence[str], file: str, course: str
) -> dict[str, Any]:
    """claims: ids, in the order of the columns; file: of its sheet"""
    clean = seen(submission)
    by_claim = {claim["id"]: claim for claim in clean["claims"]}
    verdict = _verdict(clean)
    problem = clean["problem"] or {"code": "", "text": ""}
    pictures = [_picture(picture) for picture in clean["pictures"]]
    named = [
        {"name": name, "title": _title(name, title)}
        for name, title in zip(clean["mistakes"], clean["titles"], strict=True)
    ]
    return {
        "anchor": f"s{place}",
        "id": clean["id"],
        "verdict": verdict,
        "tone": VERDICTS[verdict],
        "gravity": list(VERDICTS).index(verdict),
        "mistakes": named,
        "problem": problem["text"],
        "code": _(PROBLEMS.get(problem["code"], problem["code"])),
        "printed": _printed(submission),
        "pictures": pictures,
        "folded": len(pictures) - MOST_PICTURES,
        "points": clean["points"],
        "of": clean["of"],
        "claims": [_claim(by_claim[claim], True, clean["headline"]) for claim in claims],
        "undecided": submission["for_instructor"],
        "kind": _(KINDS[clean["kind"]]),
        "headline": clean["headline"],
        "confidence": _confidence(clean),
        "facts": clean["facts"],
        "scenes": [
            say("{scene}: {verdict}", scene=other["scene"], verdict=_(other["verdict"]))
            for other in clean["other_scenes"]
        ],
        "same": clean["same_as"],
        "perhaps": [_titles([name]) for name in clean["perhaps"]],
        "alike": [_titles(names) for names in clean["alike"]],
        "exhibits": _exhibits(clean, course),
        **_evidence(clean["evidence"] or {}),
        "file": file,
        "link": "sheets/" + quote(file),
    }


def _evidence(evidence: dict[str, Any]) -> dict[str, Any]:
    runners = [] if UNKNOWN in evidence.get("mistakes", ()) else evidence.get("runners_up", ())
    return {
        "observed": evidence.get("observed", ()),
        "settle": evidence.get("settle", ()),
        "hidden": [_titles([name]) for name in evidence.get("hidden", ())],
        "runners": [{"titles": _titles(n), "odds": digits(odds, 2)} for n, odds in runners],
    }


def _confidence(submission: dict[str, Any]) -> str:
    """Nothing where there is no verdict to be sure of."""
    if _verdict(submission) not in (RIGHT_, WRONG):
        return ""
    share = submission["confidence"]
    return _("above 99.9 %") if share > 0.999 else say("{share:.1f} %", share=100 * share)


def _title(name: str, title: str) -> str:
    return _("not in the catalogue") if name == UNKNOWN else title


def _titles(names: Sequence[str]) -> str:
    """Of mistakes that the evidence names; those of another version's catalogue by their names."""
    known = catalogue().mistakes
    titles = [title(n) if n in known else n.replace("_", " ") for n in names]
    return " + ".join(titles) or _("no mistake")
