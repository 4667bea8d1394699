"""The report: everything inside one file, and what is drawn lies where it should."""

import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.cli import evaluate
from gateway.core.detection import Circle, Detection, Ellipse, Rejection
from gateway.errors import ConfigError
from gateway.vision.offline.evaluation import case_cards, plots
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.report import About, html, worst_of
from gateway.vision.offline.evaluation.scoring import Closeness, ScoredPicture, judge
from gateway.vision.offline.evaluation.summary import series_by, summary
from gateway.vision.offline.reports.chart import Chart, ChartAxis, log_ticks, round_ticks
from gateway.vision.offline.reports.page import plain, write
from gateway.vision.offline.reports.tables import number, share
from gateway.vision.pixels import Image
from tests.self_contained import fetches_nothing

EVERY = series_by(None)
VOID = ("meta", "br", "img", "hr")


class Balanced(HTMLParser):
    """Fails on a tag that is closed out of turn; counts elements and gathers text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.count: dict[str, int] = {}
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def outcome(n: int, found: Circle | None, **more: object) -> ScoredPicture:
    label = Label.model_validate({"file": f"{n}.png", "found": True, "u": 60, "v": 50, "r": 20, **more})
    return judge(label, Detection(found), 2_500_000, (160, 120))


@pytest.fixture
def outcomes() -> list[ScoredPicture]:
    circles = [Circle(60 + n / 7, 50, 20 + n / 9) for n in range(6)]
    rows: list[ScoredPicture] = [outcome(n, c, group="<b>&", z_cm=100 + n, frame=n) for n, c in enumerate(circles)]
    rows += [outcome(6, None, frame=6), outcome(7, Circle(120, 80, 9), frame=7)]
    rows.append(judge(Label(file="e.png", found=False), Detection(None), 1_000_000, (160, 120)))
    rows.append(judge(Label(file="f.png", found=False), Detection(circles[0]), 1_000_000, (160, 120)))
    return rows


def look(_: Label) -> Image:
    return np.full((120, 160, 3), (60, 80, 100), np.uint8)


def test_one_file_that_fetches_nothing(outcomes: list[ScoredPicture]) -> None:
    results = [summary(name, outcomes, EVERY, split=True, followed=True) for name in ("paper", "robust")]
    drawn = 0

    def advance() -> None:
        nonlocal drawn
        drawn += 1

    about = About("Detection on <bay>", ("10 pictures",), ("robust: detected >= 1",), ("a note",))
    text = html(results, about, EVERY, look, {}, worst=4, advance=advance)
    page = Balanced(text)
    assert fetches_nothing(text)
    assert drawn == 8
    assert page.count["image"] == 8
    assert page.count["svg"] == 8 + 4 + 2 * 2  # cases, charts, two sequences for each method
    assert "Detection on <bay>" in page.text
    assert "<b>&" in page.text, "names of groups are text"
    assert "75.0 %" in page.text
    assert "robust: detected >= 1" in page.text
    assert "2.50" in page.text
    assert "Every requirement is met" in html(results, About("t", (), ()), EVERY, look, {}, worst=0)


@pytest.mark.parametrize(
    "bad", ['<img src="http://x/y.png">', "<script>1</script>", "<i style=\"background:url('x')\">", "@import 'a';"]
)
def test_a_page_that_fetches_something_is_noticed(bad: str) -> None:
    assert not fetches_nothing(bad)
    assert fetches_nothing('<image href="data:image/png;base64,AAAA"/><a href="#top">x</a>')


def test_a_set_with_nothing_to_draw_still_gives_a_page() -> None:
    empty = summary("m", [judge(Label(file="e", found=False), Detection(None))], EVERY, split=True, followed=False)
    text = html([empty], About("t", ()), EVERY, look, {})
    page = Balanced(text)
    assert "svg" not in page.count
    assert "0 of 1" in page.text
    for draw in (plots.centre_errors, plots.radius_errors, plots.radius_against_truth):
        assert draw([empty]) == ""
    assert plots.r_times_z([empty], EVERY) == plots.sequence(empty, "", EVERY) == ""


def test_the_worst_hold_some_of_every_fault(outcomes: list[ScoredPicture]) -> None:
    many = [outcomes[9]] * 5 + outcomes[:8]
    verdicts = [found.verdict for found in worst_of(many, 4)]
    assert verdicts == [Closeness.FALSE, Closeness.FALSE, Closeness.WRONG, Closeness.MISSED]
    assert len(worst_of(outcomes, 100)) == 9, "all but the one rightly empty"


def test_truth_and_answer_are_drawn_where_they_are() -> None:
    label = Label(file="a.png", found=True, u=60, v=50, r=20)
    rim = Ellipse(70, 55, 22, 11, np.pi / 2)
    near, far = Rejection(Circle(66, 50, 8), "fill"), Rejection(Circle(150, 110, 5), "fill")
    found = judge(label, Detection(Circle(70, 55, 22), ellipse=rim, confidence=0.75, rejected=(far, near)))
    image = look(label)
    image[50, 60] = 255
    card = case_cards.card(found, image, {"fill": "too little red"})
    assert case_cards.refused_near(found) == (near,)
    assert "too little red" in card
    assert "confidence 0.75" in card
    assert "off by: centre 11.18 px (55.9 % of R), radius +10.0 %" in card
    x, y, wide, high = case_cards.frame(found, 160, 120)
    scale = min(660 / (np.ceil(x + wide) - np.floor(x)), 440 / (np.ceil(y + high) - np.floor(y)))
    shapes = re.findall(r'cx="([\d.]+)" cy="([\d.]+)" rx="([\d.]+)" ry="([\d.]+)" fill="none"([^/]*)/>', card)
    assert len(shapes) == 6, "each with a dark one beneath"
    for (cx, cy, rx, ry, more), (u, v, a, b, colour) in zip(
        shapes[1::2], [(66, 50, 8, 8, "#ffffff"), (60, 50, 20, 20, "#35b5ff"), (70, 55, 22, 11, "#ffe14d")], strict=True
    ):
        assert float(cx) == pytest.approx((u + 0.5 - np.floor(x)) * scale, abs=0.02)
        assert float(cy) == pytest.approx((v + 0.5 - np.floor(y)) * scale, abs=0.02)
        assert [float(rx), float(ry)] == pytest.approx([a * scale, b * scale], abs=0.02)
        assert f'stroke="{colour}"' in more
        assert ("rotate(90.0" in more) is (a != b)
    dashes = re.findall(r'stroke-dasharray="([^"]*)"', card)
    assert dashes == ["2 5", "", "9 5"], "told apart without colour"


@given(
    st.floats(-200, 900), st.floats(-200, 700), st.floats(1, 400), st.floats(-100, 800), st.floats(-100, 600),
    st.floats(1, 500), st.integers(40, 640), st.integers(40, 480),
)  # fmt: skip
def test_the_frame_never_leaves_the_picture(
    u: float, v: float, r: float, u2: float, v2: float, r2: float, width: int, height: int
) -> None:
    found = judge(Label(file="a", found=True, u=u, v=v, r=r), Detection(Circle(u2, v2, r2)))
    x, y, wide, high = case_cards.frame(found, width, height)
    assert 0 <= x <= x + wide <= width + 1e-6
    assert 0 <= y <= y + high <= height + 1e-6
    assert wide >= 39
    assert high >= 26


def test_the_embedded_cut_out_is_the_picture() -> None:
    import base64

    found = judge(Label(file="a", found=False), Detection(None))
    image = look(found.label)
    image[:, :80] = (0, 0, 200)
    card = case_cards.card(found, image, {})
    match = re.search(r'href="data:image/jpeg;base64,([^"]+)"', card)
    assert match is not None
    back = cv2.imdecode(np.frombuffer(base64.b64decode(match[1]), np.uint8), cv2.IMREAD_COLOR)
    assert back is not None
    assert back.shape == (120, 160, 3)
    assert abs(back.astype(int) - image).mean() < 4
    assert "no answer" in card


def test_ticks_are_round_and_inside() -> None:
    assert round_ticks(0, 100) == [0, 20, 40, 60, 80, 100]
    assert round_ticks(-7, 7) == [-6, -4, -2, 0, 2, 4, 6]
    assert round_ticks(0.03, 0.07) == [0.03, 0.04, 0.05, 0.06, 0.07]
    assert log_ticks(0.01, 1000) == [0.01, 0.1, 1, 10, 100, 1000]
    assert log_ticks(15, 300) == [20, 50, 100, 200]
    assert log_ticks(12, 26) == [12, 14, 16, 18, 20, 22, 24, 26], "less than three of 1, 2, 5"


def test_a_sequence_has_a_gap_and_a_mark_where_nothing_was_answered() -> None:
    answers = [Circle(60, 50, 20), Circle(61, 50, 20), None, Circle(60, 54, 20)]
    rows = [outcome(n, circle, series="s", frame=10 + n) for n, circle in enumerate(answers)]
    svg = plots.sequence(summary("m", rows[::-1], EVERY, split=False, followed=True), "s", EVERY)
    lines = re.findall(r'<polyline points="([^"]+)"', svg)
    assert [len(line.split()) for line in lines] == [2, 1]
    assert svg.count("no answer") == 1
    assert "frame 12: no answer" in svg
    (x0, y0), (x1, y1) = (map(float, place.split(",")) for place in lines[0].split())
    assert (x0, y0) == (58, 186)
    assert [x1, y1] == pytest.approx([58 + (940 - 72) / 3, 186 - 158 / 4.4], abs=0.1)


def test_a_chart_puts_points_where_the_axes_say() -> None:
    chart = Chart(ChartAxis("x", 1, 100, log=True), ChartAxis("y", 0, 10), width=472, height=272)
    chart.points([(10, 5), (1e9, -1)], 0, "a", ["<one>"])
    text = chart.svg()
    assert 'cx="258.0" cy="128.0"' in text  # half way between 58 and 458, 28 and 228
    assert 'cx="458.0" cy="228.0"' in text  # clipped to the corner
    assert "&lt;one&gt;" in text


def test_numbers_for_people() -> None:
    assert [number(x) for x in (None, 0.1234, -3.456, 12.34, 123.4)] == ["–", "0.12", "-3.46", "12.3", "123"]
    assert [share(x) for x in (None, 0, 0.9987, 1, 0.001)] == ["–", "0.0 %", "99.9 %", "100 %", "0.1 %"]
    assert plain("a\x1b\udcff<\n") == "a\\x1b\\udcff&lt;\n"


def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    write(tmp_path / "new" / "a.html", "x")
    assert (tmp_path / "new" / "a.html").read_text() == "x"
    with pytest.raises(ConfigError, match="cannot be written: Is a directory"):
        write(tmp_path, "x")


@pytest.mark.parametrize(("width", "tables"), [(122, 1), (80, 2)])
def test_the_table_fits_the_terminal(
    outcomes: list[ScoredPicture], width: int, tables: int, capsys: pytest.CaptureFixture[str]
) -> None:
    outcomes.append(judge(Label(file="g.png", found=False, group="a_group_of_22_letters_"), Detection(None)))
    evaluate._show([summary("paper", outcomes, EVERY, split=True, followed=True)], width=width)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines), "nothing is cut"
    whole = [line.split()[2:] for line in lines if line.strip().startswith("whole set")]
    assert len(whole) == tables
    cells = [cell for row in whole for cell in row]
    assert cells[:6] == ["11", "75.0", "75.0", "1", "1", "1"]
    assert len(cells) == 12
    named = [line.split()[:2] for line in lines if line.strip().startswith("<b>&")]
    assert named[-1] == ["<b>&", "6"], "R times Z, by the group's name as it is written"
