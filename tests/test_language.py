"""Two languages: nothing is left untranslated, and both say the same."""

from __future__ import annotations

import json
import os
import re
import string
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from babel.messages.catalog import Message

import penumbra
from penumbra import translation
from penumbra.__main__ import main
from penumbra.compare.check.catalogue import catalogue
from penumbra.language import LANGUAGES, localised, numbers, of_environment, say, speaking
from penumbra.translation import Pair, pairs, stale
from tests.conftest import ROOT, built

NARROW = "\u202f"
NO_BREAK = "\u00a0"
FORMULAS = {
    getattr(mistake, field)
    for mistake in catalogue().mistakes.values()
    for field in ("wrong", "right")
}
"""Texts that are code: in them a colon, a point or a semicolon is the program's"""
CODE = re.compile(
    r"```.*?```"  # fenced
    r"|`[^`]*`"  # in a line
    r"|<code>.*?</code>|<pre>.*?</pre>|</?\w[^>]*>"
    r"|\$[^$]*\$"  # formulas of Markdown and Typst
    r"|\{#[^}]*\}|\{\{|\}\}|\{[^{}]*\}|%\(\w+\)s|%%"  # anchors, placeholders
    r"|\b\d{1,2}(?:,\d{1,2}(?:\.\d+)?){2,}(?![\d,])"  # a list, as it is typed
    r"|https?://\S+|\]\([^)]*\)"
    r"|&#?\w+;"
    r"|--[\w-]+|\bpenumbra \w+ [\w/.{} -]*--\w+ \w+"  # options, commands
    r"|\b[\w/*-]+\.(?:png|exr|json|html|csv|toml|md|pdf|jpg|bmp|ppm|npy|pfm|hdr|tar\.gz)\b|(?<!\w)\.[a-z]\w*",
    re.S,
)
"""What is in no language, or in the program's"""
TYPST = re.compile(
    r"^#(?:import|let|show|set)\b.*$|#[\w.-]+(?:\(|\[)|\"index\.html[^\"]*\"|//.*$"
    r"|(?:^\s*|[(,]\s*)(?:[a-z_][\w-]*|\"\w*\"):"  # a key, an argument's name
    r"|(?:\b[\w-]+: )?\b\d+(?:\.\d+)?(?:pt|em|fr|cm|mm)\b"  # a length
    r"|\b[\w-]+: (?:true|false|none|auto)\b",
    re.M,
)
VERSION = re.compile(r"\b(?:Python|bpy|WCAG|noyau|à partir de|from) \d+(?:\.\d+)+")
"""With a point in any language"""


@pytest.fixture(scope="module")
def translated() -> list[Message]:
    return [message for message in translation.translated() if message.id]


@pytest.fixture(scope="module")
def found() -> set[str]:
    return {str(message.id) for message in translation.found() if message.id}


# ---------------------------------------------------------------- the .po file


def test_every_text_is_in_the_po_file_and_every_text_of_it_is_said(
    translated: list[Message], found: set[str]
) -> None:
    known = {str(message.id) for message in translated}
    assert not found - known, "`make words`, then translate"
    assert not known - found, "obsolete: `make words`"
    assert not translation.translated().obsolete


def test_every_text_has_its_french(translated: list[Message]) -> None:
    assert [m.id for m in translated if not m.string] == []
    assert [m.id for m in translated if m.fuzzy] == []


def test_placeholders_are_the_same_in_both_languages(translated: list[Message]) -> None:
    """Names, conversions and formats, so that no number loses a digit."""
    differing = [
        (m.id, m.string)
        for m in translated
        if m.string and placeholders(m.id) != placeholders(m.string)
    ]
    assert differing == []


def test_tags_are_the_same_in_both_languages(translated: list[Message]) -> None:
    tags = re.compile(r"</?\w+[^>]*>")
    differing = [
        (m.id, m.string)
        for m in translated
        if Counter(tags.findall(m.id)) != Counter(tags.findall(m.string))
    ]
    assert differing == []


def test_formulas_keep_the_code_of_the_english(translated: list[Message]) -> None:
    """Their names and signs, but for a word or two."""
    for message in translated:
        if message.id in FORMULAS and "(" in message.id:
            calls = re.compile(r"\b\w+\(")
            assert Counter(calls.findall(message.id)) == Counter(calls.findall(message.string))


def test_numbers_are_the_same_in_both_languages(translated: list[Message]) -> None:
    differing = [
        (m.id, m.string)
        for m in translated
        if m.string and m.id not in FORMULAS and figures(m.id, "en") != figures(m.string, "fr")
    ]
    assert differing == []


def test_typography_of_the_po_file_is_french(translated: list[Message]) -> None:
    wrong = [
        (m.string, complaint)
        for m in translated
        if m.string and m.id not in FORMULAS
        for complaint in typography(m.string)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "text",
    [
        "ombre : dure",
        "Est-ce juste?",
        "juste ! ",
        "95 %",
        "« ombre »",
        'une "ombre"',
        "une “ombre”",
        "et ainsi de suite...",
        "0.5 m",
        "l'ombre",
    ],
)
def test_typography_that_is_not_french_is_found(text: str) -> None:
    assert list(typography(text))


@pytest.mark.parametrize(
    "text",
    [
        f"ombre{NO_BREAK}: dure",
        f"Est-ce juste{NO_BREAK}?",
        f"95{NO_BREAK}%",
        f"«{NO_BREAK}ombre{NO_BREAK}»",
        "`std::cos(0.5)` l’ombre…",
        "0,5 m, {file}:{line}, %(name)s",
    ],
)
def test_typography_that_is_french_passes(text: str) -> None:
    assert not list(typography(text))


@pytest.mark.parametrize(
    ("english", "french"),
    [("0.5 and 16", "0,5 et 15"), ("1,000 rays", "100 rayons"), ("(0, 0, -2)", "(0, 0, -1)")],
)
def test_a_number_that_differs_is_found(english: str, french: str) -> None:
    assert figures(english, "en") != figures(french, "fr")


@pytest.mark.parametrize(
    ("english", "french"),
    [
        ("0.5 and 16", "16 et 0,5"),
        ("10,000,000 rays", f"10{NO_BREAK}000{NO_BREAK}000 rayons"),
        ("10,000 rays", f"10{NARROW}000 rayons"),
        ("`0.5` is 20%", f"`0.1` fait 20{NO_BREAK}%"),
        ("n016_aa01.png is 16", "n016_aa01.png veut dire 16"),
    ],
)
def test_numbers_that_are_the_same_pass(english: str, french: str) -> None:
    assert figures(english, "en") == figures(french, "fr")


# ---------------------------------------------------------------- whole texts


@pytest.fixture(params=pairs(), ids=lambda pair: pair.name)
def pair(request: pytest.FixtureRequest) -> Pair:
    found: Pair = request.param
    return found


def test_no_language_of_a_text_has_changed_alone(pair: Pair) -> None:
    known = translation.agreed().get(pair.name, {})
    late = [
        said
        for section, texts in pair.sections().items()
        if (said := stale(f"{pair.name}#{section}", *texts, known.get(section)))
    ]
    assert late == []


def test_numbers_of_whole_texts_are_the_same_in_both_languages(pair: Pair) -> None:
    differing = {
        section: (in_english - in_french, in_french - in_english)
        for section, (english, french) in pair.sections().items()
        if (in_english := figures(english, "en")) != (in_french := figures(french, "fr"))
    }
    assert differing == {}, "only in English, only in French"


def test_typography_of_whole_texts_is_french(pair: Pair) -> None:
    typst = pair.french.suffix == ".typ"
    source = typst or pair.french.name.startswith("README")
    wrong = [
        (number, complaint)
        for number, line in enumerate(without_code(pair.french.read_text("utf-8")).split("\n"), 1)
        for complaint in typography(TYPST.sub("¤", line) if typst else line, source)
    ]
    assert wrong == []


def test_a_change_of_one_language_is_named_with_its_cure() -> None:
    known = translation.digests("one", "un")
    assert stale("x#1", "one", "un", known) == ""
    assert "the English has changed and the French has not" in stale("x#1", "two", "un", known)
    assert "the French has changed and the English has not" in stale("x#1", "one", "deux", known)
    assert "`make words SAME=x#1`" in stale("x#1", "one", "deux", known)
    assert "new in both languages" in stale("x#1", "two", "deux", known)
    assert "new in both languages" in stale("x#1", "one", "un", None)


# ---------------------------------------------------------------- what is said


@pytest.mark.parametrize(
    ("variables", "spoken"),
    [
        ({"LANG": "fr_FR.UTF-8"}, "fr"),
        ({"LANG": "en_GB.UTF-8"}, "en"),
        ({"LANG": "C.UTF-8"}, "en"),
        ({"LANG": "de_DE.UTF-8"}, "en"),
        ({"LANG": "en_US.UTF-8", "LC_MESSAGES": "fr_CH.UTF-8"}, "fr"),
        ({"LANG": "fr_FR.UTF-8", "LC_ALL": "C"}, "en"),
        ({"LANG": "C", "LANGUAGE": "de:fr"}, "fr"),
        ({}, "en"),
    ],
)
def test_language_is_that_of_the_environment(variables: dict[str, str], spoken: str) -> None:
    assert of_environment(variables) == spoken


def test_numbers_are_written_as_the_language_writes_them() -> None:
    with speaking("fr"):
        assert say("{share:.1%}", share=0.256) == f"25,6{NO_BREAK}%"
        assert say("{n:,}", n=12000) == f"12{NO_BREAK}000"
        assert numbers((0.5, 1)) == f"0,5{NO_BREAK}; 1"
        assert localised("1.5") == "1,5"
    assert say("{share:.1%}", share=0.256) == "25.6%"
    assert numbers((0.5, 1)) == "0.5, 1"


Checked = Callable[..., tuple[str, str, int]]


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lab's scene at N = 16, right."""
    folder = tmp_path_factory.mktemp("language")
    command = [built("bin/penumbra-render"), ROOT / "scenes/tp3.json", "--light-samples", "16"]
    subprocess.run([*command, "-o", folder / "right.exr"], check=True)
    assert main(["png", str(folder / "right.exr"), "-o", str(folder / "n016.png")]) == 0
    return folder / "n016.png"


@pytest.mark.parametrize("chosen", LANGUAGES)
def test_check_says_its_verdict_in_the_language_that_is_asked_for(
    picture: Path, chosen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, data = tmp_path / "check.html", tmp_path / "check.json"
    command = ["check", str(picture), "--lang", chosen, "--html", str(page), "--json", str(data)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert said.startswith({"en": "RIGHT: the light", "fr": f"JUSTE{NO_BREAK}: la lumière"}[chosen])
    html = page.read_text("utf-8")
    assert f'<html lang="{chosen}">' in html
    assert {"en": "The picture itself", "fr": "L’image elle-même"}[chosen] in html
    found = json.loads(data.read_text("utf-8"))
    assert found["verdict"] == "right"
    assert [code for code, _ in found["facts"]] == ["saturated"]
    if chosen == "fr":
        assert not list(typography(said))


def test_check_in_french_differs_from_english_in_texts_only(
    picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Keys, codes, numbers and the exit status are the same."""
    found = {}
    for chosen in LANGUAGES:
        file = tmp_path / f"{chosen}.json"
        command = ["check", str(picture), "--lang", chosen, "--light-samples", "64"]
        assert main([*command, "--json", str(file)]) == 1
        found[chosen] = json.loads(file.read_text("utf-8"))
    english, french = (list(leaves(found[chosen])) for chosen in LANGUAGES)
    assert [place for place, _ in english] == [place for place, _ in french]
    texts = [place for (place, a), (_, b) in zip(english, french, strict=True) if a != b]
    allowed = re.compile(r"facts\.\d+\.1|regions\.\d+\.name|observed\.\d+|settle\.\d+|origin\.")
    assert all(allowed.match(place) for place in texts), texts


def test_environment_speaks_french_and_the_option_overrides_it(picture: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("LANGUAGE", "LC_ALL")}
    environment["LANG"] = "fr_FR.UTF-8"
    command = [sys.executable, "-m", "penumbra", "check", "nowhere_n4.png"]

    def run(*more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*command, *more], capture_output=True, text=True, env=environment)

    french, english = run(), run("--lang", "en")
    assert french.stderr == f"penumbra: nowhere_n4.png{NO_BREAK}: ce fichier n’existe pas\n"
    assert english.stderr == "penumbra: nowhere_n4.png: no such file\n"
    assert french.returncode == english.returncode == 2


def test_grade_speaks_french_on_any_worker_and_writes_the_same_bytes(
    picture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By --lang or by the environment, by a process of its own or a worker's: one text."""
    folder = tmp_path / "class"
    for name in ("dupont", "durand"):
        (folder / name).mkdir(parents=True)
        (folder / name / "n64_m1.png").write_bytes(picture.read_bytes())  # it has 16
    (folder / "empty").mkdir()
    outs = [tmp_path / "one", tmp_path / "two"]
    command = ["grade", str(folder), "--hint", "3", "--jobs", "1", "-o"]
    assert main([*command, str(outs[0]), "--lang", "fr"]) == 0
    monkeypatch.setenv("LANG", "fr_FR.UTF-8")
    assert main([*command, str(outs[1])]) == 0
    monkeypatch.undo()
    names = sorted(str(file.relative_to(outs[0])) for file in outs[0].rglob("*.html"))
    for name in ("grades.json", "grades.csv", *names):
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes(), name
    grades = json.loads((outs[0] / "grades.json").read_text("utf-8"))
    assert grades["language"] == "fr"
    first, empty = grades["submissions"][0], grades["submissions"][2]
    assert first["verdict"] == "wrong"
    assert first["headline"].startswith(f"FAUX{NO_BREAK}:")
    assert empty["id"] == "empty"
    assert empty["problem"]["text"].startswith(f"Rien à juger{NO_BREAK}:")
    for name in ("index.html", "sheets.html", "sheets/dupont.html"):
        html = (outs[0] / name).read_text("utf-8")
        assert '<html lang="fr">' in html
        assert not re.search(r"\b(of|points and|wrong|light is)\b", visible(html)), name


def test_export_speaks_the_language_of_the_grades(picture: Path, tmp_path: Path) -> None:
    folder = tmp_path / "dupont"
    folder.mkdir()
    (folder / "n16_m1.png").write_bytes(picture.read_bytes())
    out = tmp_path / "out"
    assert main(["grade", str(folder), "--one", "-o", str(out), "--lang", "fr"]) == 0
    file = tmp_path / "vpl.txt"
    for more, title in (((), "Note"), (("--lang", "en"), "Grade")):
        command = ["export", "vpl", str(out / "grades.json"), "-o", str(file), *more]
        assert main(command) == 0
        said = file.read_text("utf-8")
        assert re.search(
            rf"^Comment :=>>-{title}{NO_BREAK if title == 'Note' else ''}: ", said, re.M
        )
        assert re.search(r"^Grade :=>> \d+$", said, re.M)  # VPL's own word


def test_assertions_speak_the_language_of_the_environment(
    picture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LANG", "fr_FR.UTF-8")
    with pytest.raises(penumbra.Refuted, match=f"^FAUX{NO_BREAK}: la lumière") as raised:
        penumbra.assert_right(picture, light_samples=64, hint=2)
    assert not list(typography(str(raised.value)))


# ---------------------------------------------------------------- what is looked for


def placeholders(text: str) -> set[str]:
    """{name!r:format} of a text, and %(name)s."""
    fields = string.Formatter().parse(text) if "%(" not in text else ()
    found = {
        f"{name}!{conversion}:{spec}" for _, name, spec, conversion in fields if name is not None
    }
    return found | set(re.findall(r"%\(\w+\)s", text))


def without_code(text: str) -> str:
    """With as many lines."""
    return CODE.sub(lambda code: "¤" + "\n" * code[0].count("\n"), text)


def figures(text: str, language: str) -> Counter[float]:
    """The numbers of a text, but for code."""
    text = without_code(text)
    if language == "en":
        text = re.sub(r"(?<![\d.,])\d{1,3}(?:,\d{3})+(?!\d)", lambda n: n[0].replace(",", ""), text)
        found = re.findall(r"\d+(?:\.\d+)?", text)
    else:
        spaces = f"[{NO_BREAK}{NARROW} ]"
        grouped = rf"(?<![\d,.])\d{{1,3}}(?:{spaces}\d{{3}})+(?!\d)"
        text = re.sub(grouped, lambda n: re.sub(spaces, "", n[0]), text)
        found = [n.replace(",", ".") for n in re.findall(r"\d+(?:[.,]\d+)?", text)]
    return Counter(map(float, found))


def typography(text: str, source: bool = False) -> Iterator[str]:
    """What is not as French writes it; source: of a text that is set afterwards, or that people
    read as they type it, apostrophes and quotation marks may be straight."""
    text = VERSION.sub("¤", without_code(text))
    before = rf"(?<![{NO_BREAK}{NARROW}])"
    rules = {
        "no no-break space before : ; ! ? %": rf"(?:^|{before})(?:[:;!?](?=[\s)»]|$)|(?<=[\d\s])%)",
        "no no-break space inside « »": rf"«(?![{NO_BREAK}{NARROW}])|{before}»",
        "quotation marks that are not « »": r"[“”]" if source else r"[“”\"]",
        "three dots": r"\.\.\.",
        "a decimal point": r"\d\.\d",
        "a straight apostrophe": r"(?!)" if source else r"(?<=\w)'(?=\w)",
        "a space before , or .": r"\s,(?=\s|$)|\s\.$",
    }
    for complaint, pattern in rules.items():
        for found in re.finditer(pattern, text):
            yield f"{complaint}: {text[max(0, found.start() - 25) : found.end() + 15]!r}"


def leaves(value: object, place: str = "") -> Iterator[tuple[str, object]]:
    """JSON's values, each with its place."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, f"{place}{key}.")
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from leaves(item, f"{place}{number}.")
    else:
        yield place.rstrip("."), value


def visible(html: str) -> str:
    """A page's text."""
    html = re.sub(r"<(script|style)\b.*?</\1>", "", html, flags=re.S)
    return re.sub(r"<[^>]*>", " ", html)
