"""A web process in strange hands: what it may say to the main process, and what becomes of that."""

import os
import pickle
from dataclasses import replace
from typing import Any, cast

import pytest

from gateway.audit import BURST
from gateway.children.words import Failed
from gateway.config import GatewayConfig, Intrinsics, VisionConfig
from gateway.errors import LinkError
from gateway.hmi import trust
from gateway.hmi.alarms.records import MAX_NOTE, Deed
from gateway.hmi.alarms.states import Cue
from gateway.hmi.feed import MAX_NAME, MAX_TOLD
from gateway.hmi.orders import About, Apply, Ask, Check, Order
from gateway.hmi.service import HmiService
from gateway.model import Circle, EventKind, FunctionCheck, Quality, VisionReading
from gateway.plc import Writer
from gateway.sections.hmi import HmiConfig
from tests.unit.hmi_desk import Plant, plant
from tests.virtual_time import LoopClock, run

ANNA = Writer("127.0.0.1", "anna", "technician")


def told(made: Plant, kind: EventKind) -> list[str]:
    return [row.event.detail for row in made.feed.answer(Ask(1, ())).events if row.event.kind is kind]


def test_all_that_an_honest_web_process_says_is_understood() -> None:
    intrinsics = Intrinsics(fx=600.0, fy=600.0, cx=320.0, cy=240.0, distortion=(0.1, 0.0, 0.0, 0.0))
    for word in (
        Ask(3, ("bay1",), 7, links=False),
        Order(1, ANNA, Check("bay1", FunctionCheck.MAY_MOVE_OFF)),
        Order(2, ANNA, Apply("bay1", VisionConfig(method="paper", intrinsics=intrinsics))),
        Order(3, ANNA, Deed("bay1.camera", Cue.SHELVE, "anna", "why", 5.0, 2)),
        Failed("no", config=True),
    ):
        for protocol in (4, pickle.HIGHEST_PROTOCOL):
            assert trust.CODEC.unpacked(pickle.dumps(word, protocol)) == word


class Command:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.putenv, ("TAKEN", "1")


class Attribute:
    def __reduce__(self) -> tuple[Any, ...]:
        return getattr, (FunctionCheck, "__subclasses__")


@pytest.mark.parametrize("word", [Command(), Attribute(), VisionReading(0, Quality.GOOD), Order(1, ANNA, Command())])  # type: ignore[arg-type]
def test_it_may_speak_of_nothing_else(word: object) -> None:
    with pytest.raises(pickle.UnpicklingError, match="may not"):
        trust.CODEC.unpacked(pickle.dumps(word))


def test_a_few_bytes_take_no_heap_of_memory() -> None:
    assert trust.CODEC.unpacked(b"\x80\x04Nr" + (100).to_bytes(4, "little") + b".") is None
    with pytest.raises(pickle.UnpicklingError, match="may not have"):
        trust.CODEC.unpacked(b"\x80\x04Nr" + (1 << 20).to_bytes(4, "little") + b".")


def test_an_order_can_bring_no_observation_with_it() -> None:
    """`mode` goes where readings go: a false one would be believed."""

    async def scene() -> None:
        async with plant() as made:
            reading = VisionReading(made.desk.clock.now_ns(), Quality.GOOD, Circle(320, 240, 50), frame_id=1)
            done = made.feed.carry_out(Order(1, ANNA, Check("bay1", cast("FunctionCheck", reading))))
            assert done.why == "not an order"
            assert made.controls["bay1"].state().vision.quality is Quality.WAITING

    run(scene())


def test_settings_are_checked_again() -> None:
    async def scene() -> None:
        async with plant() as made:
            made.feed.carry_out(Order(1, ANNA, Check("bay1", FunctionCheck.MAY_MOVE_KEPT)))
            forged = VisionConfig.model_construct(_fields_set={"deadline_s"}, deadline_s=1e9)
            done = made.feed.carry_out(Order(2, ANNA, Apply("bay1", forged)))
            assert "deadline_s" in done.why
            assert made.eyes["bay1"].settings == VisionConfig()
            wished = VisionConfig(coast_s=0.5, red_low_1=(0, 50, 50))
            assert made.feed.carry_out(Order(3, ANNA, Apply("bay1", wished))).why == ""
            assert made.eyes["bay1"].settings == wished

    run(scene())


def test_orders_that_come_faster_than_people_give_them_are_refused_and_change_nothing() -> None:
    async def scene() -> None:
        async with plant() as made:
            modes = (FunctionCheck.MAY_MOVE_OFF, FunctionCheck.OFF)
            whys = [made.feed.carry_out(Order(n, ANNA, Check("bay1", modes[n % 2]))).why for n in range(3 * BURST)]
            assert whys[:BURST] == [""] * BURST
            assert all("too many" in why for why in whys[BURST:])
            assert made.feed.answer(Ask(1, ())).newest_event <= BURST + 1  # and the start

    run(scene())


def test_long_names_are_clipped_where_they_are_kept() -> None:
    async def scene() -> None:
        async with plant() as made:
            long = "x" * 60_000
            who = Writer(long, long, long)
            made.feed.carry_out(Order(1, who, Check("bay1", FunctionCheck.MAY_MOVE_KEPT)))
            made.feed.carry_out(Order(2, who, Apply("bay1", VisionConfig(method="paper"))))
            made.feed.carry_out(Order(3, who, Deed("bay1.camera", Cue.SHELVE, long, "", 5)))
            assert len(made.feed.carry_out(Order(4, who, Check(long, FunctionCheck.OFF))).why) < 2 * MAX_NAME
            details = told(made, EventKind.FUNCTION_CHECK_BEGUN) + told(made, EventKind.SETTINGS_CHANGED)
            assert len(details) == 2
            assert max(map(len, details)) < 4 * MAX_NAME + MAX_TOLD
            assert all(len(alarm.who) <= MAX_NOTE for alarm in made.watch.standing(100).alarms)

    run(scene())


def test_what_only_people_can_mend_in_the_pages_does_not_end_the_gateway() -> None:
    """A ConfigError would: the supervisor takes it for the end. No page is worth a bay."""

    async def scene() -> None:
        async with plant() as made:
            host = f"{'x' * 70}.example"  # no name can have a label so long; nobody is asked
            about = About(GatewayConfig(hmi=HmiConfig(host="localhost")), LoopClock(), {})
            named = about.config.hmi.model_copy(update={"host": host})
            about = replace(about, config=about.config.model_copy(update={"hmi": named}))
            with pytest.raises(LinkError, match=r"hmi\.host"):
                await HmiService(made.feed, about, ()).run()

    run(scene())
