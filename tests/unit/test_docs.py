"""The generated parts of docs/ say what the code says, and the pages point at things that exist."""

import re
import runpy
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from gateway.web.server import manual

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
generate = SimpleNamespace(**runpy.run_path(str(DOCS / "generate.py")))
PAGES = sorted([*DOCS.rglob("*.md"), *(ROOT / "bench").rglob("*.md"), *ROOT.glob("*.md")])


@pytest.mark.parametrize(("path", "text"), [pytest.param(*pair, id=pair[0].name) for pair in generate.texts()])
def test_nothing_has_drifted(path: Path, text: str) -> None:
    assert path.read_text(encoding="utf-8") == text, "run ./dev docs"


def test_a_block_is_written_anew_and_nothing_else() -> None:
    blocks = {"a": lambda: "new\n"}
    old = "head\n<!-- generated: a -->\nold\n<!-- end -->\ntail\n"
    new = generate.page(old, blocks)
    assert new == "head\n<!-- generated: a -->\n\nnew\n\n<!-- end -->\ntail\n"
    assert generate.page(new, blocks) == new


@pytest.mark.parametrize(
    "text", ["no block", "<!-- generated: a -->\n<!-- end -->\n<!-- generated: b -->\n<!-- end -->"]
)
def test_a_missing_or_unknown_block_is_an_error(text: str) -> None:
    with pytest.raises(KeyError):
        generate.page(text, {"a": lambda: "x"})


def test_what_refers_to_another_table_stands_there() -> None:
    keys = dict(re.findall(r"^### (\S+)\n\n(.*?)(?=\n### |\Z)", generate.keys(), re.MULTILINE | re.DOTALL))
    said = {title: re.findall(r"(?:^As|as in) (`\[[\w.]+\]`)", text) for title, text in keys.items()}
    assert said["`[ranger.reconnect]`"] == ["`[mqtt.reconnect]`"]
    assert said["`[recipes.drive]`"] == ["`[drive]`"]
    assert all(keys[other].startswith("| key |") for others in said.values() for other in others)
    assert all(f"| {name} |" in keys["`[fusion]`"] for name in re.findall(r"`\w+`", keys["`[recipes.fusion]`"]))
    full, short = (
        {
            part.split("\n")[0].lower(): dict(re.findall(r"\| (`\w+`) \| (.*) \|\n", part))
            for part in text.split("### ")[1:]
        }
        for text in (generate.register_tables.markdown() + "\n", generate.registers() + "\n")
    )
    assert short["codes of ne107"]["`failure`"] == "as in bits of ne107_active"
    for title, rows in short.items():
        for name, meaning in rows.items():
            first = meaning.removeprefix("as in ").lower() if meaning.startswith("as in ") else title
            assert full[first][name] == full[title][name]


def test_check_fails_on_drift_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drifted = tmp_path / "page.md"
    drifted.write_text("old")
    monkeypatch.setitem(generate.main.__globals__, "texts", lambda: iter([(drifted, "new")]))
    monkeypatch.setitem(generate.main.__globals__, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(sys, "argv", ["generate.py", "--check"])
    assert generate.main() == 1
    assert "page.md: differs" in capsys.readouterr().out
    assert drifted.read_text() == "old"


@pytest.mark.one_interpreter
@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", path.read_text(encoding="utf-8"))
    assert [link for link in links if "://" not in link[0] and not reached(path.parent / link[0], path, link[1])] == []


def test_every_page_that_the_program_names_is_there() -> None:
    texts = [p for kind in ("*.py", "*.js", "*.css", "languages/de.json") for p in (ROOT / "gateway").rglob(kind)]
    named = {
        link for p in texts for link in re.findall(r"docs/([a-z-]+\.md)(?:#([\w-]+))?", p.read_text(encoding="utf-8"))
    }
    assert ("technician.md", "exposure") in named
    assert [link for link in named if not reached(DOCS / link[0], DOCS, link[1])] == []


def reached(target: Path, page: Path, anchor: str) -> bool:
    """Is there the file, and the place in it? A link without a file leads to a place in its own page."""
    if target == page.parent:
        target = page
    return target.exists() and (not anchor or anchor in anchors(target))


@cache
def anchors(page: Path) -> set[str]:
    tokens = manual.MARKDOWN.parse(page.read_text(encoding="utf-8"))
    return {anchor for _, anchor in manual.anchors(tokens)}


def test_each_decision_has_a_number_of_its_own_which_its_heading_says() -> None:
    pages = sorted((DOCS / "decisions").glob("*.md"))
    numbers = [int(page.name[:4]) for page in pages]
    assert numbers == list(range(1, len(pages) + 1))
    assert [int(page.read_text(encoding="utf-8").removeprefix("# ").split(".")[0]) for page in pages] == numbers
