"""The board's relay, in the core and in the compiled firmware: what holds an output, and when it drops."""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from gateway.core.readings import RelayOutput
from gateway.ranger.hcsr04.protocol import Measurement, RelayCommand, RelayReport, encode_command, frame
from tests.firmware.bench_runs import run
from tests.firmware.core import CYCLE, MS, RISE, Core

NONE, IN_PLACE, MAY_MOVE = RelayOutput
WIDTH, NEAR, FAR = 3000, 2800, 3200


class Relay:
    """A core whose measurements are replied to by hand."""

    def __init__(self) -> None:
        self.core = Core()
        self.core.receive(encode_command(RelayCommand()))

    def cycle(self, width: int | None = WIDTH) -> Measurement:
        return self.core.cycle(width)

    def reply(self, to: Measurement, output: RelayOutput = IN_PLACE, near: int = NEAR, far: int = FAR) -> None:
        assert to.relay is not None
        self.core.receive(encode_command(RelayCommand(to.relay.run, to.seq, output, near, far)))

    def output(self, after_ms: float = 0) -> int:
        """What is on so long after the newest cycle's echo."""
        known = self.core.due - CYCLE + RISE + WIDTH
        return self.core.poll(known + round(after_ms * MS) if after_ms else self.core.due - 1).output

    def on(self, output: RelayOutput = IN_PLACE) -> Measurement:
        """A cycle whose reply switches it on."""
        measured = self.cycle()
        self.reply(measured, output)
        assert self.output() == output
        return measured


@pytest.fixture
def relay() -> Iterator[Relay]:
    board = Relay()
    yield board
    assert board.core.replay() == board.core.journal
    board.core.close()


def test_without_a_command_lines_are_as_they_ever_were() -> None:
    core = Core()
    assert core.cycle(WIDTH) == Measurement(0, WIDTH)
    core.receive(b"$HCR,0000,0,0,0,0*0000\r\n?$HCR\r\n" + frame(b"HCR,0000,0,0,0") + frame(b"HCI,0000,0,0,0,0"))
    assert core.cycle(WIDTH).relay is None
    core.receive(encode_command(RelayCommand()))
    report = core.cycle(WIDTH).relay
    assert report == RelayReport(report.run if report else 0, NONE, 0)
    core.close()


def test_a_command_holds_for_280_ms_from_its_measurement(relay: Relay) -> None:
    first = relay.on()
    assert [relay.cycle().relay for _ in range(3)][-1] == RelayReport(
        first.relay.run if first.relay else 0, IN_PLACE, 1
    )
    held = relay.core
    known = held.due - 4 * CYCLE + RISE + WIDTH  # of the first one
    for _ in range(1):
        relay.core.begin()
    assert held.poll(known + 280 * MS - 1).output == IN_PLACE
    assert held.poll(known + 280 * MS).output == NONE


def test_a_number_is_obeyed_once_and_only_while_it_is_new(relay: Relay) -> None:
    old = relay.cycle()
    new = relay.cycle()
    relay.reply(new)
    assert relay.output() == IN_PLACE
    relay.core.receive(encode_command(RelayCommand()))
    for _ in range(3):
        relay.cycle()
    for stale in (new, old):
        relay.reply(stale)
        assert relay.output() == NONE
    relay.cycle()
    late = relay.cycle()
    for _ in range(4):
        relay.cycle()
    relay.reply(late)
    assert relay.output() == NONE


@pytest.mark.parametrize("change", ["run", "seq", "output", "checksum", "length", "digits", "hex", "rest", "sum"])
def test_a_command_that_is_not_for_this_measurement_or_damaged_does_nothing(relay: Relay, change: str) -> None:
    to = relay.cycle()
    assert to.relay is not None
    good = b"HCR,%04X,%d,1,2800,3200" % (to.relay.run, to.seq)
    fields = good.split(b",")
    for at in range(1, len(fields)):
        for wrong in (b"", b"G", b" 1", b":"):
            relay.core.receive(frame(b",".join([*fields[:at], wrong, *fields[at + 1 :]])))
    relay.core.receive(
        {
            "run": frame(b"HCR,%04X,%d,1,2800,3200" % (to.relay.run ^ 1, to.seq)),
            "seq": frame(b"HCR,%04X,%d,1,2800,3200" % (to.relay.run, to.seq + 1)),
            "output": frame(good.replace(b",1,", b",3,")),
            "checksum": frame(good).replace(b",2800,", b",2801,"),
            "length": b"$" + b"0" * 40 + frame(good)[1:],
            "digits": frame(good.replace(b"2800", b"0002800")),
            "hex": frame(good.replace(b"2800", b"28A0")),
            "sum": frame(good)[:-3] + b"g\r\n",
            "rest": frame(good).replace(b"\r\n", b"\rx\n"),
        }[change]
    )
    assert relay.output() == NONE
    relay.core.receive(frame(good))
    assert relay.output() == IN_PLACE


def test_a_number_beyond_16_bits_is_none(relay: Relay) -> None:
    to = relay.cycle()
    assert to.relay is not None
    relay.core.receive(frame(b"HCR,%04X,%d,1,2800,3200" % (to.relay.run, to.seq + 65536)))
    assert relay.output() == NONE


@pytest.mark.parametrize("width", [NEAR - 1, FAR + 1, None, 500])
def test_two_measurements_outside_the_band_switch_it_off_and_one_does_not(relay: Relay, width: int | None) -> None:
    relay.on()
    odd = relay.cycle(width)
    relay.reply(odd)
    assert relay.output() == IN_PLACE
    relay.reply(relay.cycle())
    assert relay.output() == IN_PLACE
    for _ in range(2):
        relay.reply(relay.cycle(width))
    assert relay.output() == NONE


def test_it_does_not_go_on_outside_its_band(relay: Relay) -> None:
    relay.reply(relay.cycle(), near=WIDTH + 1)
    assert relay.output() == NONE
    relay.reply(relay.cycle(), far=WIDTH)
    assert relay.output() == IN_PLACE


def test_from_one_output_to_the_other_both_are_off_for_two_cycles(relay: Relay) -> None:
    relay.on()
    outputs = []
    for _ in range(5):
        relay.reply(relay.cycle(), MAY_MOVE)
        outputs.append(relay.output())
    assert outputs == [NONE, NONE, NONE, MAY_MOVE, MAY_MOVE]


def test_with_the_other_pin_high_nothing_is_on(relay: Relay) -> None:
    relay.on()
    relay.core.pins(MAY_MOVE)
    assert relay.output() == NONE
    for _ in range(4):
        measured = relay.cycle()
        relay.reply(measured)
        assert relay.output() == NONE
    assert measured.relay is not None
    assert measured.relay.pins == MAY_MOVE


@pytest.mark.long
def test_the_run_is_another_one_after_65536_measurements() -> None:
    relay = Relay()
    first = relay.cycle().relay
    for _ in range(65_535):
        relay.core.begin(high=True)
        relay.core.journal.clear()
    again = relay.cycle().relay
    assert first is not None
    assert again is not None
    assert again.run != first.run
    relay.core.close()


DROPS = (
    ("renew off", "renew 1 5000 7000"),  # the gateway was killed
    ("mute on", "mute off"),  # the cable is off
    ("reset", ""),
    ("power off", "power on"),
    ("hang", ""),
    ("stall", ""),
    ("distance 700", "distance 520"),  # its own measurement leaves the band
    ("distance 300", "distance 520"),
    ("distance none", "distance 520"),
    ("sensor dead", "sensor ok"),
    ("sensor stuck", "sensor ok"),
    ("renew 2 5000 7000", "renew 1 5000 7000"),  # to the other output
)


@pytest.mark.mostly_long
@pytest.mark.parametrize("place_ms", [1, 13, 25, 37, 49])
def test_in_the_compiled_firmware_it_drops_within_300_ms_and_both_are_never_on(place_ms: int) -> None:
    """Each cause somewhere else in the cycle."""
    causes = [(960 + 1200 * n + (place_ms + 7 * n) % 60, *cause) for n, cause in enumerate(DROPS)]
    scenario = "".join(f"at {at} {drop}\n" + (f"at {at + 420} {back}\n" if back else "") for at, drop, back in causes)
    played = run("distance 520\nrenew 1 5000 7000\n" + scenario, 960 + 1200 * len(causes))
    changes = [(row["t_ns"] / 1e6, row["pins"]) for row in played.of("relay")]
    assert {pins for _, pins in changes} == {NONE, IN_PLACE, MAY_MOVE}
    took_ms = {}
    for at, drop, _ in causes:
        assert [pins for t, pins in changes if t < at][-1] == IN_PLACE, at
        took_ms[at, drop] = next(t for t, pins in changes if t >= at and pins == NONE) - at
    assert [cause for cause, ms in took_ms.items() if ms > 300] == []
    between = [(a, b) for a, b in pairwise(changes) if b[1] != NONE]
    assert min(b[0] - a[0] for a, b in between) > 120
