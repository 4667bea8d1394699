"""The pages' files: vendored libraries as they were fetched, nothing inline or foreign, and the scripts' own tests.

Node.js runs these, with its own test runner.
"""

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.core.state import GuidanceCode

STATIC = Path(__file__).parents[3] / "gateway" / "web" / "static"
PAGES = Path(__file__).parents[2] / "pages"
VENDOR = STATIC / "vendor"
OURS = sorted(path for path in STATIC.rglob("*.js") if VENDOR not in path.parents)
HTML = sorted(STATIC.glob("*.html"))
STYLES = sorted(path for path in STATIC.rglob("*.css") if VENDOR not in path.parents)
TESTS = sorted(PAGES.glob("*.test.js"))


def vendored() -> dict[str, str]:
    rows = re.findall(r"^\| (\S+) \|.*\| ([0-9a-f]{64}) \|$", (VENDOR / "VENDOR.md").read_text(encoding="utf-8"), re.M)
    return dict(rows)


def test_every_vendored_file_is_listed_and_is_what_its_package_held() -> None:
    files = {path.name for path in VENDOR.iterdir()} - {"VENDOR.md"}
    assert set(vendored()) == files
    for name, digest in vendored().items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == digest, name


def test_every_library_has_its_licence() -> None:
    for name in ("uplot", "htm", "preact"):
        assert "icense" in (VENDOR / f"{name}.LICENSE").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", HTML, ids=lambda path: path.name)
def test_a_page_has_nothing_inline_and_nothing_foreign(page: Path) -> None:
    """The Content-Security-Policy would refuse it; and a plant has no internet."""
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<script(?![^>]*\ssrc=)", text), "a script in the page"
    assert not re.search(r"<style|\sstyle=|\son\w+=", text), "a style or a handler in the page"
    for address in re.findall(r'(?:src|href|action)="([^"]+)"', text):
        assert re.fullmatch(r"/(?!/).*|#.*", address), address
    assert re.search(r'<html lang="\w\w"', text)
    assert '<meta name="viewport"' in text


def files_asked_for(path: Path) -> list[Path]:
    """Of a page or a script: what the browser will fetch for it."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".html":
        found = re.findall(r'(?:src|href)="/static/([^"]+)"', text)
        return [STATIC / name for name in found]
    return [(path.parent / name).resolve() for name in re.findall(r"""from\s+'(\.[^']+)'""", text)]


@pytest.mark.parametrize("path", [*HTML, *OURS], ids=lambda path: path.relative_to(STATIC).as_posix())
def test_what_a_page_or_script_asks_for_is_there(path: Path) -> None:
    for wanted in files_asked_for(path):
        assert wanted.is_file(), f"{path.name} asks for {wanted}"
        assert STATIC.resolve() in wanted.resolve().parents


@pytest.mark.parametrize("script", OURS, ids=lambda path: path.relative_to(STATIC).as_posix())
def test_no_script_makes_code_or_markup_of_text(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert not re.search(r"\beval\(|new Function\(|innerHTML|outerHTML\s*\+?=|insertAdjacentHTML|document\.write", text)
    assert not re.search(r"https?://(?!www\.w3\.org/)", text), "an address of somewhere else"


@pytest.mark.parametrize("script", OURS, ids=lambda path: path.relative_to(STATIC).as_posix())
def test_what_a_page_draws_goes_through_the_viewers_language(script: Path) -> None:
    if script.name != "page.js":
        assert "vendor/preact-htm" not in script.read_text(encoding="utf-8"), "import from lib/page.js"


@pytest.mark.parametrize("style", STYLES, ids=lambda path: path.relative_to(STATIC).as_posix())
def test_styles_fetch_nothing_from_elsewhere(style: Path) -> None:
    text = style.read_text(encoding="utf-8")
    assert "@import" not in text
    assert not re.search(r"url\((?!['\"]?/static/)", text)


# What letters and spaces are made of; style.css says how large each is. In a drawing (SVG) sizes are of the drawing.
SCALE = r"var\(--(small|normal|large|huge|space-\d|gap|pad)\)|calc\(|\)|-1|2|[*+]|auto|inherit|0|400|600|\s"
SCALED = r"(?<![\w-])(font-size|font-weight|(?:row-|column-)?gap|padding(?:-\w+)*|margin(?:-\w+)*):\s*([^;}]+)"
DESKS = [path for path in STYLES if path.name != "driver.css"]  # its sizes follow its screen


@pytest.mark.parametrize("style", DESKS, ids=lambda path: path.relative_to(STATIC).as_posix())
def test_letters_and_spaces_are_of_one_scale(style: Path) -> None:
    text, _, _ = style.read_text(encoding="utf-8").partition("@page")  # what follows is for paper
    text = re.sub(r"(:root|\.chart text) \{ font-size[^}]*\}", "", text)
    found = [f"{name}: {value}" for name, value in re.findall(SCALED, text) if not re.fullmatch(f"({SCALE})+", value)]
    assert [each for each in found if each not in ("margin-left: -2px", "margin-top: 2px", "row-gap: 2px")] == []


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts beside their tests, told to Node.js as modules."""
    there = tmp_path_factory.mktemp("pages")
    shutil.copytree(STATIC, there / "static")
    shutil.copytree(PAGES, there / "tests", ignore=shutil.ignore_patterns("node_modules"))
    (there / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    (there / "codes.json").write_text(json.dumps([code.name for code in GuidanceCode]), encoding="utf-8")
    return there


PARSE = """
import { readFileSync } from 'node:fs';
import vm from 'node:vm';
for (const path of process.argv.slice(1)) new vm.SourceTextModule(readFileSync(path, 'utf8'), { identifier: path });
"""


def node(*words: str | Path, cwd: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(["node", *words], cwd=cwd, capture_output=True, text=True, timeout=110, check=False)


def test_every_script_is_a_module_that_parses(room: Path) -> None:
    names = [path.relative_to(STATIC).as_posix() for path in OURS]
    assert "driver.js" in names
    done = node("--experimental-vm-modules", "--input-type=module", "-e", PARSE, *names, cwd=room / "static")
    assert done.returncode == 0, done.stderr


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_scripts_own_tests_pass(room: Path) -> None:
    """Each of them is counted, so that a file the runner no longer finds is noticed."""
    written = sum(len(re.findall(r"^test\(", path.read_text(encoding="utf-8"), re.M)) for path in TESTS)
    assert written >= 40
    every = "".join(
        f"import './tests/{path.name}';" for path in TESTS
    )  # one process: a start takes longer than all tests
    done = node("--test-reporter=tap", "--input-type=module", "-e", every, cwd=room)
    assert done.returncode == 0, done.stdout
    passed = re.search(r"^# pass (\d+)$", done.stdout, re.M)
    assert passed
    assert int(passed[1]) == written, done.stdout
