"""The manual as the pages serve it: what a page may contain, where its links lead, and what is refused."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gateway.web.server import manual
from tests.unit.web.auth import Browser
from tests.unit.web.test_site import site
from tests.virtual_time import in_virtual_time

PAGE = """# A page <b>

<!-- generated: x -->
<script>alert(1)</script>

## What it's for
## What it's for

[a](javascript:alert(1)) [b](other.md#there) [c](../secret.md) [d](#what-its-for) [e](https://example.org/)
![f](images/shot.png) ![g](images/../secret.png) ![h](data:text/html,x)

| n |
|--:|
| 1<br>2 |
"""


def test_a_page_has_no_html_of_its_own_and_its_links_stay_in_the_manual(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "page.md").write_text(PAGE)
    monkeypatch.setattr(manual, "PAGES", {"page": tmp_path / "page.md", "other": tmp_path / "other.md"})
    monkeypatch.setattr(manual, "IMAGES", {"shot.png": tmp_path / "shot.png"})
    text = manual.html.__wrapped__("page")
    assert "<title>A page &lt;b&gt;</title>" in text
    body = text.partition("<article")[2].partition("</article>")[0]
    assert "generated" not in body
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in body
    assert re.findall(r'<h2 id="([^"]+)"', body) == ["what-its-for", "what-its-for-1"]
    assert re.findall(r'href="([^"]*)"', body) == ["/manual/other#there", "#what-its-for", "https://example.org/"]
    assert re.findall(r'src="([^"]*)"', body) == ["/manual/images/shot.png"]
    assert "<td>1 2</td>" in body
    assert not re.search(r"style=|<script|<br", body)


class Addresses(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value for key, value in attrs if key in ("href", "src") and value is not None]


@pytest.mark.one_interpreter
def test_every_page_is_listed_and_rendered_with_its_pictures() -> None:
    listed = [
        address.removeprefix("/manual/") for address in Addresses(manual.contents()).found if "manual/" in address
    ]
    assert listed[0] == "technician"
    assert sorted(listed) == sorted(manual.PAGES)
    shown = {address for name in listed for address in Addresses(manual.html(name)).found}
    assert "/manual/images/hmi-teach-in.png" in shown
    for address in shown:
        if address.startswith("/manual/images/"):
            assert address.removeprefix("/manual/images/") in manual.IMAGES, address


@in_virtual_time
async def test_it_is_for_who_may_see_the_operators_page_and_holds_nothing_else() -> None:
    async with site() as real:
        browser = Browser(real)
        answer = await browser.get("/manual/technician")
        assert (answer.status, answer.headers["location"]) == (303, "/login?next=/manual/technician&need=viewer")
        await browser.login("vera")
        answer = await browser.get("/manual/technician")
        assert answer.status == 200
        assert '<h2 id="teach-in">Teach-in</h2>' in answer.text
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert (await browser.get("/manual")).status == 200
        picture = await browser.get("/manual/images/hmi-teach-in.png")
        assert (picture.status, picture.headers["content-type"]) == (200, "image/png")
        for path in ("../pyproject", "..", "/etc/passwd", "images/../technician.md", "images/..", "technician.md", "x"):
            assert (await browser.get(f"/manual/{path}")).status == 404, path
