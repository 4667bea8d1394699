"""The table of sentences: each is found again by its text, with its values, and each is in every language."""

from collections.abc import Callable
from typing import Any

import pytest

from gateway.core import details
from gateway.core.details import DETAILS, Detail, told
from gateway.errors import ProtocolError
from gateway.modbus.protocol.answers import MAY_NOT_WRITE
from gateway.records import sentences as account
from gateway.records.record import unpacked
from gateway.records.segment import batch_of, head_of
from gateway.records.sentences import SENTENCES
from gateway.records.sentences import said as said_of_account
from gateway.web.languages import languages
from gateway.web.server.models import said
from tests.page_texts import of_the_details

DAY = "2026-12-01"
MADE = ("12", "3.5", "-4", "+7")


def test_codes_and_texts_are_unique() -> None:
    known = SENTENCES.details
    assert len({one.code for one in known}) == len({one.text for one in known}) == len(known) > 200


@pytest.mark.parametrize("detail", SENTENCES.details, ids=lambda one: one.code)
def test_each_sentence_is_found_again_with_its_values(detail: Detail) -> None:
    count = detail.text.count("{")
    values = tuple(f"plc {n}" if n in detail.words else MADE[n] for n in range(count))
    (found,) = (told if detail in DETAILS else SENTENCES.told)(detail(*values))
    assert (found.detail, found.values) == (detail, values)


def test_a_text_of_several_sentences_and_one_in_another() -> None:
    visit = told("560 s, never in place, corrections 0, not released")
    assert [one.detail.code for one in visit] == [
        *("visit_length", "visit_never", "visit_corrections", "visit_not_released")
    ]
    (rolls,) = said("by range: Z 300 mm, R 100.0 px at (1, 2) -> Z unknown, marker not seen")
    before, after = (one[0] for one in rolls.values[1:] if not isinstance(one, str))
    assert (rolls.code, rolls.values[0]) == ("rolling", "range")
    assert (before.code, before.values, after.code) == ("where", ("300", "100.0", "1", "2"), "where_unknown")


def test_pictures_that_were_not_kept_and_the_alarm_of_them() -> None:
    text = "7 of 9 pictures of departure, in_place_ended: picture_mb_per_day is used up"
    (event,) = said(text)
    why = event.values[3]
    assert (event.code, event.values[:3]) == ("pictures_not_kept", ("7", "9", "departure, in_place_ended"))
    assert not isinstance(why, str)
    assert [one.code for one in why] == ["pictures_budget"]
    assert [one.code for one in said(f"12 since the start of the gateway; bay1: {text}")] == [
        *("counted", "pictures_of_bay")
    ]


def test_what_is_not_the_gateways_own_has_no_code() -> None:
    assert [told(text) for text in ("", "connection refused", "[Errno 19] No such device, errno 19")] == [()] * 3


@pytest.mark.parametrize("word", ["by ", "camera: ", "x, connection y: "])
def test_a_text_that_is_too_long_is_anothers(word: str) -> None:
    for text in (word * 1000, ("by " + "x" * 600)[:601]):
        assert (told(text), SENTENCES.told(text), said(text), said_of_account(text)) == ((), (), (), [])
    assert told(("by " + "x" * 600)[:600]) != ()


def test_sentences_in_one_another_end_at_a_depth() -> None:
    value: Any = said("by " * 199 + "x")
    for _ in range(6):
        ((value,),) = (one.values for one in value)
    assert value == "by " * 193 + "x"
    found: Any = said_of_account("camera: " * 70 + "x")
    for _ in range(6):
        ((found,),) = (one["values"] for one in found)
    assert found == "camera: " * 64 + "x"


def test_the_refusal_of_a_write_is_the_servers() -> None:
    assert details.MAY_NOT_WRITE.text == f"{{0}}: {MAY_NOT_WRITE}"


@pytest.mark.parametrize("code", ["de", "es", "tr"])
def test_every_sentence_is_in_every_language(code: str) -> None:
    texts = languages({}).catalogues[code].texts
    assert of_the_details() - set(texts) == set()
    for key in of_the_details():
        text = texts[key]
        assert isinstance(text, str)
        assert sorted(p for p in "0123" if f"{{{p}}}" in text) == sorted(p for p in "0123" if f"{{{p}}}" in key), key


@pytest.mark.parametrize(
    ("text", "code", "values"),
    [
        ("cam: vision process was killed by SIGSEGV in the source's driver", "driver_crashed", ["cam", "killed_by"]),
        ("vision process ended with exit code 7", "vision_ended", ["exit_code"]),
        (
            "modbus.tls.cert: /a/gw.pem expires on 2026-12-01",
            "cert_expires",
            ["modbus.tls.cert: /a/gw.pem", DAY],
        ),
        ("the certificate of mqtts://b:8883 expired on 2026-12-01", "brokers_expired", ["mqtts://b:8883", DAY]),
        ("mqtt://b:1883: connection lost: no answer to a PINGREQ", "link_lost_why", ["mqtt://b:1883", "no_pingresp"]),
    ],
)
def test_a_sentence_within_another_has_its_own_code(text: str, code: str, values: list[str]) -> None:
    (found,) = said(text)
    assert found.code == code
    assert [value if isinstance(value, str) else value[0].code for value in found.values] == values


def test_several_certificates_are_several_sentences() -> None:
    assert [one.code for one in said("a: /x expires on 2026-12-01; b: /y expired on 2026-11-01")] == [
        "cert_expires", "cert_expired",
    ]  # fmt: skip


def of_another_version(read: Callable[[bytes], object]) -> str:
    with pytest.raises(ProtocolError) as error:
        read(b"\xc1")
    return account.PART_OF("7.seg", error.value)


@pytest.mark.parametrize(
    ("why", "code"),
    [
        (account.BETWEEN("3.seg", "5.seg"), "missing_between"),
        (account.START_BEFORE("5.seg"), "missing_start"),
        (account.STEPS_BEFORE(12, "5.seg"), "missing_steps"),
        (account.RECORDS_LOST("5.seg", 3, account.NOT_IN_TIME()), "records_lost"),
        (account.HEAD_DAMAGED("5.seg"), "head_damaged"),
        (account.CUT_OFF("5.seg", 12), "cut_off"),
        (account.DAMAGED("5.seg", 12, 400), "bytes_damaged"),
        (of_another_version(unpacked), "of_later_version"),
        (of_another_version(batch_of), "of_later_version"),
        (of_another_version(head_of), "of_later_version"),
    ],
)
def test_what_is_missing_in_a_recording_is_a_sentence_of_its_own(why: str, code: str) -> None:
    (found,) = said_of_account(account.MISSING(why))
    assert found["code"] == "missing"
    ((inner,),) = found["values"]
    assert inner["code"] == code
