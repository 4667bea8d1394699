"""Answers from recordings: their numbers."""

import io
import json
import zipfile
from collections import Counter
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.core.state import StateVector
from gateway.errors import ConfigError, ProtocolError
from gateway.processes.answers import NothingError, QuestionRefusedError
from gateway.records import answers, reader_process
from gateway.records.answers import answer
from gateway.records.index_rows import SegmentRows
from gateway.records.questions import QUESTIONS, EvidenceQuestion, Question, ValuesQuestion, WhyQuestion
from gateway.records.record import Decision, TickRecord
from gateway.records.recorder_service import head_of
from tests import recorded_bay
from tests.recorded_bay import CONFIG
from tests.unit.records.test_segment import HEAD
from tests.unit.web.history import BEGIN_MS, LATER_MS, folder_of, recorded

pytestmark = pytest.mark.one_interpreter

ASKED = ValuesQuestion("bay1", 1, 2, 3)
S = 10**9


def values(folder: Path, since_ms: int, until_ms: int, points: int) -> Any:
    return json.loads(answer(folder_of(folder), ValuesQuestion("bay1", since_ms, until_ms, points)))


def test_values_are_those_of_the_records(tmp_path: Path) -> None:
    recorded(tmp_path)
    found = values(tmp_path, BEGIN_MS + 20_000, BEGIN_MS + 40_000, 4)
    assert (found["bucket_ms"], found["missing"]) == (5000, [])
    first, second, third, fourth = found["buckets"]
    assert [b["t_ms"] - BEGIN_MS for b in found["buckets"]] == [20_000, 25_000, 30_000, 35_000]
    # R grows by 2 px a second from 100 px; then it is 180 px.
    assert (first["r_min"], first["r_mean"], first["r_max"]) == (140.0, 144.0, 148.0)
    assert (second["r_max"], second["z_mean"], third["r_min"], third["z_max"]) == (158.0, 900.0, 180.0, 300.0)
    assert (first["may_move_s"], first["in_place_s"], first["stop_s"], first["frames"]) == (5.0, 0.0, {}, 5)
    # What was decided holds until the next record, here half a second into the next part.
    assert (third["may_move_s"], third["in_place_s"], third["stop_s"]) == (0.5, 4.5, {"target_reached": 4.5})
    assert (fourth["recorded_s"], fourth["in_place_s"]) == (5.0, 5.0)


def test_values_across_what_was_not_recorded(tmp_path: Path) -> None:
    bay = recorded(tmp_path)
    found = values(tmp_path, BEGIN_MS, LATER_MS + 60_000, 12)
    assert found["bucket_ms"] == 60_000
    assert [(b["t_ms"], b["recorded_s"]) for b in found["buckets"]] == [(BEGIN_MS, 59.5), (LATER_MS, 59.5)]
    assert found["buckets"][1]["stop_s"] == {"vision_stale": 59.5}
    (path,) = bay.glob("00000006-*.seg")
    path.write_bytes(path.read_bytes()[:-5])
    found = values(tmp_path, BEGIN_MS, LATER_MS + 60_000, 12)
    assert [b["t_ms"] for b in found["buckets"]] == [BEGIN_MS]
    assert len(found["missing"]) == 1
    assert path.name in found["missing"][0]
    assert values(tmp_path, BEGIN_MS + 10_000, BEGIN_MS + 10_400, 2000)["bucket_ms"] == 100  # not finer
    assert values(tmp_path, 0, 60_000, 10)["buckets"] == []
    with pytest.raises(ConfigError):
        answer(folder_of(tmp_path), ValuesQuestion("bay2", 0, 1, 1))


def test_nothing_is_known_of_the_time_across_what_is_missing() -> None:
    state = StateVector("bay1", HEAD.t_ns, stop=False, may_move=True)
    ticks = [TickRecord(t_ns=HEAD.t_ns + n * S // 10) for n in range(1, 4)]

    def known_s(between: Callable[[SegmentRows], None]) -> object:
        rows = SegmentRows(HEAD, 60 * S)
        rows.add(Decision.of(state))
        rows.add(ticks[0])
        between(rows)
        rows.add(ticks[1])
        rows.add(ticks[2])
        rows.finish()
        return rows.minutes[0][1]

    assert known_s(lambda rows: None) == 0.3
    assert known_s(SegmentRows.broken) == 0.1
    assert known_s(lambda rows: rows.follow(HEAD)) == 0.1


def test_why_as_json_and_as_a_report(tmp_path: Path) -> None:
    kept, _ = recorded_bay.recorded(tmp_path, until_s=40)
    kept.picture(recorded_bay.T0_NS + 19 * S, 500, "operator_mark")
    at_ms = recorded_bay.unix(recorded_bay.T0_NS + 20 * S) // 10**6
    folder = tmp_path / "site.gateway"
    told = json.loads(answer(folder, WhyQuestion("bay1", at_ms, html=False, pictures=True)))
    assert (told["bay"], told["outputs"]["may_move"], told["silence"]) == ("bay1", "on", "")
    assert [picture["frame_id"] for picture in told["pictures"]] == [500]
    page = answer(folder, WhyQuestion("bay1", at_ms, html=True, pictures=True)).decode()
    assert page.startswith("<!DOCTYPE html>")
    assert "frame 500" in page
    assert "data:image" in page
    without = answer(folder, WhyQuestion("bay1", at_ms, html=True, pictures=False)).decode()
    assert "data:image" not in without
    assert "records.pictures_for" in without


def test_only_questions_are_read() -> None:
    asked: list[Question] = [ASKED, WhyQuestion("bay1", 5, html=True, pictures=False)]
    for question in asked:
        assert QUESTIONS.unpacked(QUESTIONS.packed(question)) == question
    for data in (b"", b"\xc0", msgspec.msgpack.encode(["WhyQuestion", "bay1", "soon", True, True])):
        with pytest.raises(ProtocolError):
            QUESTIONS.unpacked(data)


def test_where_nothing_is_recorded_nothing_is_the_answer(tmp_path: Path) -> None:
    with pytest.raises(NothingError, match="bay1"):
        reader_process._answer(answers, tmp_path, ASKED, (), lambda piece: None)


def test_evidence_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, _ = recorded_bay.recorded(tmp_path, until_s=80)
    kept.picture(recorded_bay.T0_NS + 30 * S, 500, "operator_mark")
    begin_ms = recorded_bay.unix(recorded_bay.T0_NS + 25 * S) // 10**6
    folder, asked = tmp_path / "site.gateway", EvidenceQuestion("bay1", begin_ms, begin_ms + 10_000, pictures=True)

    def given(question: EvidenceQuestion) -> zipfile.ZipFile:
        pieces: list[bytes] = []
        answers.give_evidence(folder, question, pieces.append)
        assert pieces[-1] == b""
        assert all(len(piece) <= answers.PIECE_BYTES for piece in pieces)
        return zipfile.ZipFile(io.BytesIO(b"".join(pieces)))

    found = given(asked)
    assert found.testzip() is None
    data = {name.partition("/")[2]: found.read(name) for name in found.namelist()}
    kinds = Counter(Path(name).suffix for name in data)
    assert (kinds[".pictures"], kinds[".html"], kinds[".txt"], kinds[""]) == (1, 1, 1, 1)
    assert kinds[".seg"] >= 2
    sums = data.pop("SHA256SUMS").decode().splitlines()
    assert sums == [f"{sha256(content).hexdigest()}  {name}" for name, content in data.items()]
    assert all(data[path.name] == path.read_bytes() for path in kept.path.iterdir() if path.name in data)
    assert b"data:image" in data["why.html"]
    without = given(msgspec.structs.replace(asked, pictures=False))
    assert not any(name.endswith(".pictures") for name in without.namelist())
    page = next(without.read(name) for name in without.namelist() if name.endswith("why.html"))
    assert b"data:image" not in page
    monkeypatch.setattr(answers, "MOST_EVIDENCE_BYTES", 1000)
    with pytest.raises(QuestionRefusedError, match=r"at most; gateway export --evidence"):
        given(asked)
    sent: list[bytes] = []
    with pytest.raises(NothingError):
        reader_process._answer(answers, tmp_path, asked, (), sent.append)
    assert sent == []


@pytest.mark.parametrize(("damaged", "why"), [(True, "no why.html: "), (False, "does not fit: bays")])
def test_evidence_without_a_report_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damaged: bool, why: str
) -> None:
    if not damaged:
        refused = msgspec.structs.replace(head_of(CONFIG, CONFIG.bays[0], "a"), config='{"bays": 5}')
        monkeypatch.setattr(recorded_bay, "head_of", lambda *_: refused)
    kept, _ = recorded_bay.recorded(tmp_path, until_s=60)
    paths = sorted(kept.path.glob("*.seg"))
    for path in paths if damaged else []:
        whole = path.read_bytes()
        path.write_bytes(whole[:40] + bytes([whole[40] ^ 1]) + whole[41:])
    begin_ms = recorded_bay.unix(recorded_bay.T0_NS + 25 * S) // 10**6
    pieces: list[bytes] = []
    asked = EvidenceQuestion("bay1", begin_ms, begin_ms + 10_000, pictures=True)
    answers.give_evidence(tmp_path / "site.gateway", asked, pieces.append)
    found = zipfile.ZipFile(io.BytesIO(b"".join(pieces)))
    data = {name.partition("/")[2]: found.read(name) for name in found.namelist()}
    assert {"verify.txt", "SHA256SUMS"} < data.keys()
    assert "why.html" not in data
    assert why in data["verify.txt"].decode().splitlines()[-1]
    assert sum(data.get(path.name) == path.read_bytes() for path in paths) >= 2
