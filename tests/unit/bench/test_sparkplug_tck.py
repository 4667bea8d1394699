"""What bench.sparkplug_tck reads of the TCK's summary and of the specification, and when a test has passed."""

from pathlib import Path

import pytest

from bench.sparkplug_tck.build import EDITS, PACKAGE, BuildError, build, edited, requirements, sections, statements
from bench.sparkplug_tck.results import Outcome, markdown, not_applicable, outcome, verdict

PAGE = Path(__file__).parents[3] / "bench" / "reports" / "sparkplug.md"
SUMMARY = """2026-11-23 15:59:41.0 Summary Test Results for Edge SendData
Monitor:tck-id-topic-structure: PASS;
tck-id-topics-ndata-mqtt: NOT EXECUTED;
tck-id-topics-ddata-mqtt: PASS;
tck-id-payloads-ddata-qos: FAIL DDATA messages MUST be published with the MQTT QoS set to 0. (SendDataTest.java:1);
tck-id-payloads-metric-datatype-not-req: MAYBE The datatype SHOULD NOT be included;
OVERALL: FAIL but INCOMPLETE;
"""


def test_a_summary_is_read() -> None:
    found = outcome(SUMMARY.splitlines())
    assert found.overall == "FAIL but INCOMPLETE"
    assert found.status == {
        "tck-id-topic-structure": "PASS",
        "tck-id-topics-ndata-mqtt": "NOT EXECUTED",
        "tck-id-topics-ddata-mqtt": "PASS",
        "tck-id-payloads-ddata-qos": "FAIL",
        "tck-id-payloads-metric-datatype-not-req": "MAYBE",
    }
    assert found.why == {
        "tck-id-payloads-ddata-qos": "DDATA messages MUST be published with the MQTT QoS set to 0. "
        "(SendDataTest.java:1)",
        "tck-id-payloads-metric-datatype-not-req": "The datatype SHOULD NOT be included",
    }


@pytest.mark.parametrize(
    ("monitor", "test", "status"),
    [("PASS", "FAIL", "FAIL"), ("FAIL", "PASS", "FAIL"), ("NOT EXECUTED", "PASS", "PASS"), ("MAYBE", "PASS", "MAYBE")],
)
def test_the_worse_of_monitor_and_test_counts(monitor: str, test: str, status: str) -> None:
    found = outcome([f"Monitor:tck-id-payloads-ddeath-seq-inc: {monitor};", f"tck-id-payloads-ddeath-seq-inc: {test};"])
    assert found.status == {"tck-id-payloads-ddeath-seq-inc": status}


def of(overall: str = "PASS", **status: str) -> Outcome:
    return Outcome({f"tck-id-{name}": value for name, value in status.items()}, {}, overall)


def test_an_assertion_of_one_version_of_mqtt_alone_is_reached_in_one_run() -> None:
    runs = {"3.1.1": of(a="PASS", b="NOT EXECUTED"), "5": of(a="NOT EXECUTED", b="PASS")}
    found = verdict("SessionTermination", runs, {})
    assert found.passed
    assert str(found) == "SessionTermination: PASSED (2 PASS)"


def test_what_no_run_reached_is_open_unless_the_page_excuses_it() -> None:
    runs = {"3.1.1": of(a="PASS", b="NOT EXECUTED"), "5": of(a="PASS", b="NOT EXECUTED")}
    found = verdict("SendData", runs, {})
    assert not found.passed
    assert str(found) == "SendData: FAILED (1 PASS, 1 NOT EXECUTED; not reached: tck-id-b)"
    assert verdict("SendData", runs, {"tck-id-b": "no aliases are used"}).passed
    assert not verdict("SendData", runs, {"tck-id-c": "no aliases are used"}).passed


def test_one_failed_run_fails_a_test_and_a_should_does_not() -> None:
    found = verdict("SendData", {"3.1.1": of(a="PASS"), "5": of(a="FAIL")}, {"tck-id-a": "excused"})
    assert not found.passed
    assert [row.name for row in found.failed] == ["tck-id-a"]
    should = verdict("SendData", {"5": of(a="MAYBE")}, {})
    assert should.passed
    assert str(should) == "SendData: PASSED (1 MAYBE)"


def test_a_run_without_a_summary_has_not_passed() -> None:
    found = verdict("SendData", {"3.1.1": of(a="PASS"), "5": of("", a="PASS")}, {})
    assert not found.passed
    assert str(found) == "SendData: FAILED (1 PASS; no summary with MQTT 5)"
    assert not verdict("SendData", {"5": of()}, {}).passed


def test_the_table_has_a_row_for_each_assertion() -> None:
    runs = {"3.1.1": of(a="PASS", b="NOT EXECUTED"), "5": of(a="PASS")}
    assert markdown([verdict("SendData", runs, {"tck-id-a": "passed", "tck-id-b": "no aliases"})]).splitlines() == [
        "| test | assertion | MQTT 3.1.1 | MQTT 5 | |",
        "|---|---|---|---|---|",
        "| SendData | `tck-id-a` | PASS | PASS |  |",
        "| SendData | `tck-id-b` | NOT EXECUTED | NOT EXECUTED | no aliases |",
    ]


def test_the_page_tells_what_does_not_apply_to_this_edge_node() -> None:
    excused = not_applicable(PAGE.read_text(encoding="utf-8"))
    assert excused["tck-id-payloads-alias-uniqueness"] == "no aliases are used"
    assert "tck-id-topics-ddata-mqtt" not in excused


SPECIFICATION = """
* [tck-testable tck-id-topics-nbirth-mqtt]#[yellow-background]*[tck-id-topics-nbirth-mqtt]
NBIRTH messages MUST be published with "QoS" 0.*#
[tck-testable tck-id-payloads-req]#[yellow-background]*[tck-id-payloads-other] Another
id is shown.*#
"""


def test_the_statements_of_the_specification_become_constants() -> None:
    found = statements(SPECIFICATION)
    assert found == {
        "topics-nbirth-mqtt": 'NBIRTH messages MUST be published with "QoS" 0.',
        "payloads-req": "Another id is shown.",
    }
    assert requirements(found).splitlines()[2:4] == [
        '  public final static String ID_TOPICS_NBIRTH_MQTT = "tck-id-topics-nbirth-mqtt";',
        "  public final static String TOPICS_NBIRTH_MQTT = \"NBIRTH messages MUST be published with 'QoS' 0.\";",
    ]
    assert sections(["@A(section = Sections.B_C, id = 1)", "Sections.A Sections.B_C"]).splitlines()[2:-1] == [
        '  public final static String A = "a";',
        '  public final static String B_C = "b_c";',
    ]


def test_another_version_of_the_tck_is_reported_not_patched_around(tmp_path: Path) -> None:
    path = PACKAGE / "test/Results.java"
    assert edited(path, 'x = "tcp://localhost:1883";') == 'x = System.getProperty("broker");'
    with pytest.raises(BuildError, match="is not in this version of the TCK"):
        edited(path, 'x = "tcp://localhost:1884";')
    assert edited(Path("Other.java"), "x") == "x"
    assert path in EDITS
    with pytest.raises(BuildError, match=r"git clone https://github\.com/eclipse-sparkplug/sparkplug"):
        build(tmp_path, tmp_path)
