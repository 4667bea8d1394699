"""A segment that is not there is missing, whoever reads the recording; and what the chain of hashes proves."""

import html
import json
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.cli.main import main
from gateway.core.state import Reason
from gateway.records import account, page, recording
from gateway.records.completeness import Verified, verified
from gateway.records.inquiry import Answer, Inquiry
from gateway.records.moment import shown
from gateway.records.segment import MAGIC, BlockKind, block, blocks
from tests.long import mostly_long
from tests.recorded_bay import T0_NS, Recorded, S, recorded, unix
from tests.visit_bench import Bench, truck

pytestmark = pytest.mark.one_interpreter


@pytest.fixture(scope="module", params=mostly_long([True, False]), ids=["chained", "of an earlier version"])
def gap(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Segments of 20 s, without that from second 16 on."""
    folder, _ = recorded(tmp_path_factory.mktemp("gap"), until_s=50, chained=request.param)
    segment(folder, 2).unlink()
    return folder


@pytest.fixture(scope="module")
def recording_of_50_s(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(tmp_path_factory.mktemp("whole"), until_s=50)[0]


@pytest.fixture
def whole(recording_of_50_s: Recorded, tmp_path: Path) -> Recorded:
    """Three or more segments, to be changed."""
    copy = Recorded(tmp_path)
    for path in recording_of_50_s.path.iterdir():
        (copy.path / path.name).write_bytes(path.read_bytes())
    return copy


def segment(folder: Recorded, number: int) -> Path:
    (found,) = folder.path.glob(f"0000000{number}-*.seg")
    return found


def answer(folder: Recorded, t_s: float) -> Answer:
    return Inquiry(folder.path).at(unix(T0_NS + round(t_s * S)))


def replayed(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[int, dict[str, Any]]:
    code = main(["replay", *map(str, args), "--json"])
    return code, json.loads(capsys.readouterr().out)


def said(what: str, folder: Recorded, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    code = main(["records", what, str(folder.path.parent)])
    return code, [line.strip() for line in capsys.readouterr().out.splitlines()]


def with_a_newer_key(path: Path) -> None:
    head = recording.head_in(path)
    assert head is not None
    with_other_head(path, config=json.dumps(json.loads(head.config) | {"of_a_later_version": 1}))


def with_other_head(path: Path, **other: str) -> None:
    head = recording.head_in(path)
    assert head is not None
    data = path.read_bytes()
    rest = data[next(b.size + b.offset for b in blocks(data) if not hasattr(b, "length")) :]
    head = msgspec.structs.replace(head, **other)
    path.write_bytes(MAGIC + block(BlockKind.HEAD, msgspec.json.encode(head)) + rest)


class TestAMissingSegment:
    def test_of_its_time_nothing_is_claimed(self, gap: Recorded) -> None:
        found = answer(gap, 30)
        assert (found.state, found.since_ns, len(found.missing)) == (None, None, 1)
        assert found.silence == f"records are missing: {found.missing[0]}"
        assert segment(gap, 3).name in found.silence
        assert "no tick" not in str([link.by for link in (*found.chain, *found.after)])

    def test_behind_it_nothing_before_it_is_a_cause(self, gap: Recorded) -> None:
        found = answer(gap, 45)
        assert found.state is not None
        assert found.state.reason is Reason.NONE
        assert found.silence == ""
        assert "no tick" not in str([link.by for link in (*found.chain, *found.after)])

    def test_the_report_draws_nothing_across_it(self, gap: Recorded) -> None:
        text = page.html(answer(gap, 30), [], "now")
        chart = text[: text.index("The outputs after each step")].rpartition("<svg")[2]
        assert chart.count("<polyline") == 6, "each of three outputs has a line before the gap and one behind it"

    def test_the_report_has_its_sentences_as_codes_for_a_page_in_another_language(self, gap: Recorded) -> None:
        found = answer(gap, 30)
        text = page.html(found, [], "now")
        said = json.loads(text.partition('id="said">')[2].partition("</script>")[0])
        assert said == account.said(found)
        assert said[account.headline(found)][0]["code"] == "records_missing"
        for kind, sentence in said.items():  # what stands in the report word for word
            assert html.escape(kind) in text, sentence

    def test_the_replay_begins_again_behind_it(
        self, gap: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        code, told = replayed(capsys, gap.path)
        assert (code, told["same"], told["differing"], len(told["missing"])) == (1, True, 0, 1)
        same = tmp_path / "same.toml"
        same.write_text('[modbus]\nplc_addresses = ["10.0.0.9"]\nhandshake = { heartbeat_required = false }\n')
        code, told = replayed(capsys, gap.path, "--against", same)
        assert (code, told["otherwise"], len(told["missing"])) == (1, [], 1)

    def test_it_is_reported_by_verify(self, gap: Recorded, capsys: pytest.CaptureFixture[str]) -> None:
        code, lines = said("verify", gap, capsys)
        assert code == 1
        assert len([line for line in lines if segment(gap, 3).name in line]) >= 1
        assert "faults: 1" in lines[-1] + lines[-2]

    def test_an_interval_of_other_decisions_ends_before_it(
        self, gap: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        other = tmp_path / "other.toml"
        other.write_text(
            '[fusion]\nradius_threshold_px = 10\ndistance_threshold_mm = 900\n[modbus]\nplc_addresses = ["10.0.0.9"]\n'
            "handshake = { heartbeat_required = false }\n"
        )
        _, told = replayed(capsys, gap.path, "--against", other)
        assert sum(float(row["seconds"].removesuffix(" s")) for row in told["otherwise"]) < 40


def test_a_segment_with_a_key_of_a_newer_version_is_missing_and_no_more(
    whole: Recorded, capsys: pytest.CaptureFixture[str]
) -> None:
    with_a_newer_key(segment(whole, 2))
    found = answer(whole, 30)
    assert found.state is None
    assert "of_a_later_version" in found.silence
    assert answer(whole, 45).silence == ""
    code, told = replayed(capsys, whole.path)
    assert (code, told["same"], len(told["missing"])) == (1, True, 1)
    assert told["steps"] > 2000
    whole.number = 10
    whole.picture(T0_NS, 1, "stop_raised")
    (pictures,) = whole.path.glob("*.pictures")
    with_a_newer_key(pictures)
    code, told = replayed(capsys, whole.path, "--frames")
    assert (code, told["pictures"], len(told["missing"])) == (1, 0, 1)


class TestTheChain:
    def test_what_is_complete_is_proven(self, whole: Recorded, capsys: pytest.CaptureFixture[str]) -> None:
        code, lines = said("verify", whole, capsys)
        segments = len(list(whole.path.glob("*.seg")))
        assert (code, lines[-1]) == (0, f"proven by the segment behind them: {segments - 1}; faults: 0")

    def test_all_of_some_time_is_one_file_of_evidence_that_sha256sum_checks(
        self, whole: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        whole.number = 10
        whole.picture(T0_NS + 30 * S, 7, "moved")
        begin = ["--from", shown(unix(T0_NS + 24 * S)), "--to", shown(unix(T0_NS + 26 * S))]
        target = tmp_path / "case.zip"
        assert main(["export", str(whole.path), "--evidence", str(target), *begin]) == 0
        assert capsys.readouterr().out.startswith(f"{target}: segments: 3; files of pictures: 0; proven")
        with zipfile.ZipFile(target) as file:
            file.extractall(tmp_path)
        case = tmp_path / "case"
        checked = subprocess.run(
            ["sha256sum", "-c", "SHA256SUMS"], cwd=case, capture_output=True, text=True, check=True
        )
        names = [segment(whole, n).name for n in (1, 2, 3)] + ["why.html", "verify.txt"]
        assert checked.stdout.splitlines() == [f"{name}: OK" for name in names]
        assert segment(whole, 2).read_bytes() == (case / names[1]).read_bytes()
        assert "proven by the segment behind them: 2; faults: 0" in (case / "verify.txt").read_text()
        assert "bay1, 2026-11-23" in (case / "why.html").read_text()
        capsys.readouterr()
        assert main(["records", "verify", str(case)]) == 0, "unpacked"
        assert capsys.readouterr().out.splitlines() == [
            f"case: 3 segments, {names[0]} to {names[2]}",
            "  proven by the segment behind them: 2; faults: 0",
        ]
        assert main(["export", str(whole.path), "--evidence", str(target), *begin]) == 2, "nothing is written over"
        path = segment(whole, 2)
        path.write_bytes(path.read_bytes() + block(BlockKind.RECORDS, b""))
        begin[3] = shown(unix(T0_NS + 31 * S))
        assert main(["export", str(whole.path), "--evidence", str(tmp_path / "b.zip"), *begin]) == 1
        out = capsys.readouterr().out
        assert f"missing: {path.name}: not the bytes that were written" in out
        assert "files of pictures: 1" in out
        assert not list(tmp_path.glob(".evidence-*"))

    def test_one_that_was_changed_with_a_good_crc(self, whole: Recorded, capsys: pytest.CaptureFixture[str]) -> None:
        path = segment(whole, 2)
        path.write_bytes(path.read_bytes() + block(BlockKind.RECORDS, b""))
        code, lines = said("verify", whole, capsys)
        assert code == 1
        assert f"{path.name}: not the bytes that were written, says {segment(whole, 3).name}" in lines

    def test_one_that_the_limits_delete_once_it_was_read(self, whole: Recorded) -> None:
        paths = recording.segments_of([whole.path])
        read: list[Path] = []

        def one_more() -> None:
            read.append(paths[len(read)])
            if len(read) > 1:
                read[-2].unlink()  # the one behind it has been read

        assert verified(paths, one_more) == Verified((), len(paths) - 1, 0)

    def test_one_of_another_bay_hides_no_gap(self, whole: Recorded, capsys: pytest.CaptureFixture[str]) -> None:
        path = segment(whole, 2)
        with_other_head(path, bay="bay7")
        found = verified(recording.segments_of([whole.path]))
        gap = f"everything between {segment(whole, 1).name} and {segment(whole, 3).name}"
        other = f"{path.name}: of another recording: site1.gateway/bay7, not site1.gateway/bay1"
        assert {gap, other} <= set(found.faults)
        assert found.proven == len(list(whole.path.glob("*.seg"))) - 3
        assert f"missing: {gap}" in said("list", whole, capsys)[1]

    def test_no_step_of_one_recording_leads_to_another_s(
        self, whole: Recorded, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """Folders of two gateways merged: their times overlap."""
        second = segment(whole, 2)
        alien = second.with_name(second.name.replace("00000002-", "00000900-"))
        alien.write_bytes(second.read_bytes())
        with_other_head(alien, instance="other")
        other = f"{alien.name}: of another recording: site1.other/bay1, not site1.gateway/bay1"
        assert other in said("list", whole, capsys)[1][-1]
        assert main(["replay", str(whole.path)]) == 1
        out = capsys.readouterr().out
        assert f"missing: {other}" in out
        assert "the same: every output" in out
        assert main(["why", shown(unix(T0_NS + 25 * S)), "--records", str(whole.path)]) == 2
        assert f"{other}: give the segments of each a folder of their own" in capsys.readouterr().err

    def test_a_damaged_head_is_of_no_earlier_version(self, whole: Recorded) -> None:
        segment(whole, 2).write_bytes(b"")
        assert verified(recording.segments_of([whole.path])).unchained == 0

    def test_one_that_was_cut(self, whole: Recorded, capsys: pytest.CaptureFixture[str]) -> None:
        path = segment(whole, 2)
        data = path.read_bytes()
        path.write_bytes(data[:-20])
        code, lines = said("verify", whole, capsys)
        assert code == 1
        assert any(
            line.startswith(f"{path.name}: cut at its end: {len(data) - 20} of {len(data)} bytes") for line in lines
        )

    def test_the_end_that_a_power_cut_took_is_not_a_change(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = Recorded(tmp_path)
        bench = Bench(truck(), record=folder.collector)
        bench.run(2)
        path = folder.write(T0_NS)
        path.write_bytes(path.read_bytes()[:-20])
        folder.names(path)
        bench.power_on()
        folder.write(bench.now_ns, boot="b")
        code, lines = said("verify", folder, capsys)
        assert code == 1
        assert lines[-1] == "proven by the segment behind them: 1; faults: 1"
        assert lines[1].startswith(f"the end of {path.name}, cut off or damaged")

    def test_list_tells_a_missing_segment_from_a_time_without_records(
        self, whole: Recorded, capsys: pytest.CaptureFixture[str]
    ) -> None:
        segment(whole, 2).unlink()
        code, lines = said("list", whole, capsys)
        assert code == 0
        assert f"missing: everything between {segment(whole, 1).name} and {segment(whole, 3).name}" in lines
