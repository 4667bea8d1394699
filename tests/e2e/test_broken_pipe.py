"""Whoever reads the gateway's output, or does not, or goes away, never touches the registers."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from gateway.core.state import Reason
from tests.e2e.plc import Plc

STANDING = "seed = 3\nstart = { distance_cm = 45 }\n"
PIPE_BYTES = 4096  # the smallest there is: it fills in a moment


def start(folder: Path, *args: str, stdout: int, stderr: int) -> "subprocess.Popen[bytes]":
    path = folder / "scenario.toml"
    path.write_text(STANDING)
    ports = ("--modbus-port", "0", "--hmi-port", "0")
    command = [sys.executable, "-m", "gateway", "simulate", "--scenario", str(path), *ports, *args]
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr, bufsize=0, pipesize=PIPE_BYTES
    )


def first_line(process: "subprocess.Popen[bytes]") -> bytes:
    assert process.stdout is not None
    line = b""
    while not line.endswith(b"\n"):
        piece = process.stdout.read(1)
        assert piece, line
        line += piece
    return line


def full(process: "subprocess.Popen[bytes]") -> None:
    """Wait until its output has no room for another line."""
    assert process.stdout is not None
    deadline = time.monotonic() + 30
    while waiting(process.stdout.fileno()) < PIPE_BYTES - 700:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def waiting(pipe: int) -> int:
    """Bytes that nobody has read."""
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


@pytest.mark.long
def test_output_that_nobody_reads_holds_up_nobody(tmp_path: Path) -> None:
    process = start(tmp_path, "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        port = json.loads(first_line(process))["modbus_port"]
        with Plc(port) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1)
            full(process)
            plc.wait_for_beats(100)
            assert not plc.failures
            process.send_signal(signal.SIGTERM)
            # Still unread: whatever waited for a reader would wait for ever, and what the interpreter does about a
            # lock that is never given back is to abort, with code -6 and a word about it.
            assert process.wait(60) == 0
            assert plc.last["reason"] == Reason.SHUTDOWN
        assert process.stderr is not None
        assert process.stderr.read() == b""
    finally:
        process.kill()
        process.wait(10)
        for stream in (process.stdout, process.stderr):
            assert stream is not None
            stream.close()


@pytest.mark.mostly_long
@pytest.mark.parametrize("args", [("--json",), ("--quiet",)])
def test_a_reader_that_goes_away_ends_it_in_order_and_in_silence(tmp_path: Path, args: tuple[str, ...]) -> None:
    with (tmp_path / "stderr").open("wb") as log:
        process = start(tmp_path, *args, stdout=subprocess.PIPE, stderr=log.fileno())
        try:
            first_line(process)
            assert process.stdout is not None
            process.stdout.close()
            assert process.wait(20) == 1
        finally:
            process.kill()
            process.wait(10)
    assert (tmp_path / "stderr").read_text() == ""


def test_a_full_disk_ends_it_in_order(tmp_path: Path) -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    with (tmp_path / "stderr").open("wb") as log:
        process = start(tmp_path, "--json", stdout=full, stderr=log.fileno())
        os.close(full)
        try:
            assert process.wait(20) == 1
        finally:
            process.kill()
            process.wait(10)
    assert (tmp_path / "stderr").read_text() == ""


SHORT = [("registers",), ("registers", "--format", "json"), ("--help",), ("detect", "--help"), ("--version",)]


def short(*args: str, stdout: int) -> "subprocess.CompletedProcess[bytes]":
    """A verb whose few lines wait in the buffer until its end."""
    command = [sys.executable, "-m", "gateway", *args]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, timeout=60, check=False)


@pytest.mark.mostly_long
@pytest.mark.parametrize("args", SHORT)
def test_a_short_verb_without_a_reader_fails_in_silence(args: tuple[str, ...]) -> None:
    read, write = os.pipe()
    os.close(read)
    done = short(*args, stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.mostly_long
@pytest.mark.parametrize("args", SHORT)
def test_a_short_verb_on_a_full_disk_says_so(args: tuple[str, ...]) -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    done = short(*args, stdout=full)
    os.close(full)
    assert done.returncode == 1
    assert done.stderr == b"gateway: the output cannot be written: No space left on device\n"
