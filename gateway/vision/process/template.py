"""The template of the vision processes: imports what they need, builds each detector once, and is forked into them.

So libraries, compiled kernels and what a method prepares are loaded once for all bays.
"""

from importlib import import_module
from typing import NoReturn

import cv2

import gateway.vision.process.vision_process
import gateway.vision.source.capture
import gateway.vision.source.files  # noqa: F401 - all three are for the processes forked from this one
from gateway.clock import SystemClock
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec
from gateway.processes.fork_server import Fork, Forked, Preloaded, serve
from gateway.vision.transport.messages import TemplateJob

CODEC = Codec(TemplateJob | Fork, compressed=True)


def run(channel: Channel[Preloaded | Forked, Fork], job: TemplateJob) -> NoReturn:
    """Until the main process ends. Raises what a detector raises that can't be built."""
    cv2.setNumThreads(1)  # none is started
    for module in job.sources:
        import_module(module)
    for detector in job.detectors:
        detector.build(SystemClock().now_ns)
    serve(channel)
