"""A GStreamer pipeline as a camera: its frames, its end, its hang, and who may write it."""

import asyncio
import io
import math
import os
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

from gateway.clock import SystemClock
from gateway.config import CameraConfig
from gateway.core.readings import AgeProof, Quality
from gateway.errors import ConfigError, LinkError
from gateway.vision.source.gst_source import BUFFER, CAPS, ChildOutput, Packet, packet, size_px
from gateway.vision.source.specs import source_spec
from tests.e2e.test_vision_pool import Bay

LIVE = "videotestsrc is-live=true pattern=snow ! video/x-raw,width=161,height=120,framerate=25/1"


def url(folder: Path, pipeline: str, mode: int = 0o444) -> str:
    file = folder / "pipeline"
    file.write_text(f"{pipeline}\n")
    file.chmod(mode)
    return f"gst://{file}"


def test_frames_have_the_pipelines_size_and_times_and_its_end_is_a_lost_camera(tmp_path: Path) -> None:
    clock = SystemClock()
    source = source_spec(CameraConfig(url=url(tmp_path, LIVE.replace("snow", "red num-buffers=250")))).open(clock)
    frames = [source.read() for _ in range(15)]
    with pytest.raises(LinkError, match="the pipeline has ended: without a word"):
        frames.extend(iter(source.read, None))
    source.close()
    assert {frame.pixels.shape for frame in frames} == {(120, 161, 3)}
    assert frames[-1].pixels[60, 160].tolist() == pytest.approx([0, 0, 255], abs=2)
    times_ns = [frame.t_capture_ns for frame in frames]
    assert times_ns == sorted(set(times_ns))
    assert times_ns[-1] <= clock.now_ns()
    assert frames[-1].age_proof is AgeProof.PRESENTATION_TIME


def test_what_is_wrong_with_the_pipeline_is_said_in_gstreamers_words(tmp_path: Path) -> None:
    for pipeline, words in (
        ("v4l2src device=/dev/video77", "Cannot identify device"),
        ("no_such_element", 'no element "no_such_element"'),
    ):
        source = source_spec(CameraConfig(url=url(tmp_path, pipeline))).open(SystemClock())
        with pytest.raises(LinkError, match=words):
            source.read()
        source.close()
        (tmp_path / "pipeline").unlink()


def test_a_pipeline_that_stands_still_is_killed_with_its_process_and_begun_anew(tmp_path: Path) -> None:
    def pipelines() -> list[psutil.Process]:
        children = psutil.Process().children(recursive=True)
        return [one for one in children if one.name().startswith("gst-launch")]

    async def scene() -> None:
        async with Bay(url(tmp_path, LIVE), detector=None, deadline_s=2.0) as bay:
            seen = await bay.quality(Quality.NO_TARGET)
            (before,) = pipelines()
            before.send_signal(signal.SIGSTOP)
            lost = await bay.quality(Quality.LINK_DOWN, seen)
            assert "no frame within 2 s" in bay.readings[lost].detail
            await bay.quality(Quality.NO_TARGET, lost)
            assert [one.pid for one in pipelines()] != [before.pid]
            assert not before.is_running()

    asyncio.run(scene())  # its end asserts that no process is left


@pytest.mark.parametrize("mode", [0o644, 0o464, 0o446])
def test_a_file_that_a_page_could_have_written_is_no_pipeline(tmp_path: Path, mode: int) -> None:
    with pytest.raises(ConfigError, match="must be read-only for everybody"):
        source_spec(CameraConfig(url=url(tmp_path, LIVE, mode)))


def test_what_could_never_work_is_a_configuration_error(tmp_path: Path) -> None:
    for address, words in (
        ("gst://videotestsrc", "needs the path of a file"),
        (f"gst://{tmp_path}/none", "No such file"),
        (url(tmp_path, "videotestsrc 'x"), "no pipeline: No closing quotation"),
    ):
        with pytest.raises(ConfigError, match=words):
            source_spec(CameraConfig(url=address))


def header(kind: int, length: int, stamp_ns: int = 0, major: int = 1) -> bytes:
    return struct.pack(">BBBxHIQQQQ20x", major, 0, 0, kind, length, stamp_ns, 0, 0, 0)


def test_packets_of_the_data_protocol() -> None:
    caps = b"video/x-raw, format=(string)BGR, width=(int)320, height=(int)240, framerate=(fraction)25/1\0"
    none = 2**64 - 1
    stream = io.BytesIO(header(CAPS, len(caps)) + caps + header(BUFFER, 3, 40_000_000) + b"abc" + header(1, 0, none))
    first = packet(stream)
    assert first is not None
    assert (first.kind, size_px(first.payload)) == (CAPS, (320, 240))
    assert packet(stream) == Packet(BUFFER, b"abc", 40.0)
    last = packet(stream)
    assert last is not None
    assert math.isnan(last.stamp_ms)
    assert packet(stream) is None
    assert packet(io.BytesIO(header(BUFFER, 9) + b"cut")) is None
    for wrong in (header(BUFFER, 0, major=0), header(BUFFER, 2**32 - 1)):
        with pytest.raises(ValueError, match="data protocol"):
            packet(io.BytesIO(wrong))
    with pytest.raises(ValueError, match="without a size"):
        size_px(b"video/x-raw, format=(string)RGB, width=(int)3, height=(int)2")


def test_a_pipeline_that_says_much_before_its_first_frame_is_not_held_up(tmp_path: Path) -> None:
    """5 MB, of which a pipe takes 64 KiB."""
    child = subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stderr.write('word ' * 1_000_000); sys.stdout.write('frame')"],
        bufsize=0,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert child.stdout is not None
    assert child.stderr is not None
    os.set_blocking(child.stderr.fileno(), False)
    output = ChildOutput(child.stdout, child.stderr)
    assert output.read(6) == b"frame"
    assert "word word" in output.said
    child.wait(30)
    child.stdout.close()
    child.stderr.close()


def test_the_permission_is_that_of_the_file_that_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another one, which nobody may write, takes its name after it was opened."""
    address, other, opened = url(tmp_path, LIVE, mode=0o644), tmp_path / "other", os.open
    other.write_text(LIVE)
    other.chmod(0o444)

    def swapped(path: str, flags: int, *args: Any, **kwargs: Any) -> int:
        fd = opened(path, flags, *args, **kwargs)
        if str(path) == address.removeprefix("gst://"):
            other.replace(path)
        return fd

    monkeypatch.setattr(os, "open", swapped)
    with pytest.raises(ConfigError, match="must be read-only for everybody"):
        source_spec(CameraConfig(url=address))
