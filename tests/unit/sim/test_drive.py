"""The simulated drive: its registers, its timeout, and what the camera's process sees of the vehicle."""

from pathlib import Path

import pytest

from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Peer
from gateway.sim.drive import TIMEOUT_S, DriveRegisters
from gateway.sim.driven_way import DrivenWay, WayFile
from gateway.sim.scenario import parse
from gateway.sim.vehicles import Tractor, TractorData
from gateway.sim.world import Motion, World

PLC = Peer("127.0.0.1")


@pytest.fixture
def drive() -> DriveRegisters:
    return DriveRegisters(Tractor(TractorData(step_mm_s=20)), start_mm=1500.0)


def advanced(drive: DriveRegisters, from_s: float, to_s: float, write: tuple[int, int] | None) -> float:
    """The way at `to_s`, with a write every 0.2 s and a step every 0.02 s."""
    way_mm = 0.0
    for tick in range(round((to_s - from_s) * 50)):
        if write is not None and tick % 10 == 0:
            assert drive.write(0, write, PLC) is None
        way_mm, _ = drive.advance(from_s + (tick + 1) * 0.02)
    return way_mm


def test_it_stands_until_somebody_writes_run_and_a_speed(drive: DriveRegisters) -> None:
    assert advanced(drive, 0, 2, None) == 0
    assert advanced(drive, 2, 4, (0, 200)) == 0
    assert drive.read() == (0, 200, 0, 0)
    assert advanced(drive, 4, 6, (1, 200)) == pytest.approx(200 * (2 - 0.2 - 0.33), abs=6)
    assert drive.read() == (1, 200, 1, 200)


def test_without_a_writer_it_stops_and_starts_only_after_control_was_0(drive: DriveRegisters) -> None:
    advanced(drive, 0, 2, (1, 200))
    stopped_mm = advanced(drive, 2, 5, None)
    # It goes on for the timeout, counted from the last write at 1.8 s, and then runs out within lag and brake.
    assert stopped_mm == pytest.approx(200 * (1.8 + TIMEOUT_S - 0.3 - 0.33 + 0.3) + 200**2 / 800, abs=15)
    assert drive.read() == (1, 200, 2, 0)
    assert advanced(drive, 5, 6, (1, 200)) == stopped_mm
    drive.write(0, (0,), PLC)
    assert drive.read()[2] == 0
    assert advanced(drive, 6, 7, (1, 200)) > stopped_mm


def test_away_from_the_spout_is_negative(drive: DriveRegisters) -> None:
    assert advanced(drive, 0, 3, (1, 0x10000 - 40)) < -60
    assert drive.read()[3] == 0x10000 - 40


def test_it_stays_within_the_ways_of_a_scenario(drive: DriveRegisters) -> None:
    assert advanced(drive, 0, 5, (1, 0x8000)) == 1500 - 5000
    assert drive.read()[3] == 0


def test_status_and_speed_can_not_be_written(drive: DriveRegisters) -> None:
    for address, words in ((2, (0,)), (1, (0, 0)), (0, (0, 0, 0))):
        assert drive.write(address, words, PLC) is ModbusException.ILLEGAL_ADDRESS
    assert drive.read() == (0, 0, 0, 0)


def test_a_mask_changes_its_bits_only(drive: DriveRegisters) -> None:
    drive.write(1, (0x00FF,), PLC)
    drive.write(1, (0x1200,), PLC, mask=0xFF00)
    assert drive.read()[1] == 0x12FF


def test_it_comes_to_stand_at_what_is_behind_the_spout(drive: DriveRegisters) -> None:
    assert advanced(drive, 0, 12, (1, 200)) == 1455.0


def test_both_processes_see_the_vehicle_where_it_was_driven_to(tmp_path: Path) -> None:
    path = str(tmp_path / "track")
    world = World(parse({"start": {"distance_cm": 150}, "vibration": {"amplitude_mm": 0}}), track=DrivenWay(path))
    assert (world.truth(3.0).distance_mm, world.truth(3.0).phase) == (1500.0, Motion.HOLD)
    file = WayFile(path)
    file.drove(1.0, 100.0, 50.0)
    assert world.truth(0.9).distance_mm == 1500.0
    truth = world.truth(1.04)
    assert (truth.distance_mm, truth.speed_mm_s, truth.phase) == (1398.0, 50.0, Motion.APPROACH)
    assert world.truth(9.0).distance_mm == 1395.0  # a process that was held moves nothing
    file.drove(1.02, 101.0, -50.0)
    assert world.truth(1.02).phase is Motion.RETREAT
    file.close()


def test_the_track_never_grows_and_the_newest_place_counts(tmp_path: Path) -> None:
    path = tmp_path / "track"
    file = WayFile(str(path))
    for n in range(1000):
        file.drove(n * 0.02, float(n), 0.0)
    file.close()
    assert path.stat().st_size == 512 * 24
    assert DrivenWay(str(path)).at(100.0) == (999.0, 0.0)
    assert DrivenWay(str(path)).at(15.0) == (750.0, 0.0)
