"""No language misses a text of the operator's page; what it misses of the others is listed by one command."""

import re
from pathlib import Path

import pytest

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.web.languages import SHIPPED, languages
from tests.page_texts import (
    DESK,
    STATIC,
    WORDS,
    literals_of,
    main,
    of_languages,
    page_texts,
    required_texts,
    templates_of,
    texts_of,
)

# Expressions whose values are words or names: a page finds a text again by its numbers only.
WORDY = re.compile(
    r"\.join\(|\b(?:t|translated|words|title|range)\(|'(?!(?:px|mm|ms|MB|Hz|dB)')[^']*[^\W\d_]{2}|"
    r"(?:^|\.)(?:name|title|text|message|why\w*|failed|path|file|bay|url|address|pattern|what|label|reason|key)$"
)
LANGUAGES = of_languages()


def test_the_languages_of_the_desks_are_found() -> None:
    assert sorted(LANGUAGES) == ["de", "es", "tr"]


@pytest.mark.parametrize("code", LANGUAGES)
def test_a_language_has_every_text_of_the_operators_page(code: str) -> None:
    assert sorted(required_texts() - LANGUAGES[code]) == [], f"{SHIPPED / code}.json misses these"


@pytest.mark.long
@pytest.mark.one_interpreter
def test_what_is_required_is_the_operators_page_and_no_other() -> None:
    required = required_texts()
    assert {"MAY MOVE", "Acknowledge", "Password"} <= required
    assert "Begin function check" not in required
    assert required < page_texts()
    assert {alarm.title for alarm in BAY_ALARMS} <= page_texts() - required


@pytest.mark.one_interpreter
def test_one_command_lists_what_a_language_lacks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lacks = {"de": page_texts() - {"MAY MOVE", BAY_ALARMS[0].title} | {"Shown no more"}}
    monkeypatch.setattr("tests.page_texts.of_languages", lambda: lacks)
    main()
    assert capsys.readouterr().out.splitlines() == [
        "de.json: 2 texts missing, shown in English; 1 that no page shows",
        f"  missing: {BAY_ALARMS[0].title}",
        "  missing, required: MAY MOVE",
        "  not shown: Shown no more",
    ]


@pytest.mark.one_interpreter
def test_the_words_that_are_listed_stand_in_some_script() -> None:
    assert WORDS - set().union(*(literals_of(script) for script in DESK)) == set()


def wordy(script: Path) -> list[str]:
    return [f"{text}: {one}" for text, values in templates_of(script) for one in values if WORDY.search(one)]


@pytest.mark.one_interpreter
def test_a_value_that_is_a_word_is_put_into_its_text_by_text(tmp_path: Path) -> None:
    """`${name} is too large` would be looked up as it stands; `text('{0} is too large', name)` is found."""
    assert {script.name: found for script in DESK if (found := wordy(script))} == {}
    script = tmp_path / "page.js"
    script.write_text(
        "const a = [`${file.name} is too large`, `changed: ${keys.join(', ')}.`, `${on ? 'one more' : 'no'} thing`];\n"
        "const fine = [`${n} of ${list.length} frames`, `${number(ms, 1, 'ms')} a frame`];\n"
        "html`<p class=${`a ${name}`}>`;"
    )
    assert wordy(script) == [
        "{0} is too large: file.name", "changed: {0}.: keys.join(', ')", "{0} thing: on ? 'one more' : 'no'",
    ]  # fmt: skip


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_value_of_a_text_is_in_its_translation(code: str) -> None:
    for key, text in languages({}).catalogues[code].texts.items():
        assert isinstance(text, str)
        assert sorted(re.findall(r"\{\d\}", text)) == sorted(re.findall(r"\{\d\}", key)), key
        assert text.strip() == text != "", key


def test_what_is_read_of_a_script(tmp_path: Path) -> None:
    script = tmp_path / "page.js"
    script.write_text(
        "import { x } from './some file.js'; // A comment's `own words\n"
        "const a = /it's [`/]/.test(b) ? 'two words' : 'one';\n"
        "html`<p class=${c ? 'not this' : ''} title=\"What it is\">"
        "Of ${n} days ${d && html`<b>inside it</b>`} end.</p>`;\n"
        "const more = `${n} of ${m} trucks, 8 h`; const drawn = `M2 2H18V16`; const size = `${n} x ${m} px`;\n"
        "html`<${Facts} facts=${[['frames summed', `${n} to ${m}`]]} key=${'no text'} note=\"a note\" />`;\n"
    )
    assert texts_of(script) == {
        "./some file.js", "two words", "What it is", "Of", "days", "inside it", "end.", "{0} of {1} trucks, {2} h",
        "frames summed", "{0} to {1}", "a note", "no text",
    }  # fmt: skip
    assert "MAY MOVE" in texts_of(STATIC / "lib" / "views.js")
