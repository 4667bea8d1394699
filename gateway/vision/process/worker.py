"""A vision process: look at the frames it is given, in place. What the detector throws ends the process."""

import gc

import cv2

from gateway.processes.channel import Link
from gateway.processes.codec import Codec
from gateway.vision.detect.method import RadiusLimited
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.picture.measure import PictureMeter
from gateway.vision.process.worker_job import WorkerJob
from gateway.vision.source.freshness import seen_ns
from gateway.vision.transport.messages import Look, Looked, Ready
from gateway.vision.transport.ring import Ring

CODEC = Codec(WorkerJob | Look | MarkerRadii, compressed=True)


def run(link: Link[Ready | Looked, Look | MarkerRadii], job: WorkerJob) -> None:
    """Until the main process is gone. Never returns."""
    cv2.setNumThreads(1)  # workers are the parallelism; threads inside them only fight
    ring = Ring(job.ring, writable=False)
    detect = job.detector.build(job.clock.now_ns)
    meter = PictureMeter()
    gc.collect()
    gc.freeze()  # 40,000 objects of the libraries, kept for good, are not looked through again every now and then
    link.send(Ready())
    newest = 0
    while True:
        message = link.receive()
        if isinstance(message, MarkerRadii):
            if isinstance(detect, RadiusLimited):
                detect.expect(message)
            continue
        frame = message.frame
        detection, since_ns, picture = None, 0, None
        # One from the main process and one from the camera itself may cross: a method with a memory sees time go on.
        if frame.seq > newest:
            newest = frame.seq
            image = ring.view(frame.slot, frame.generation)
            if image is not None:
                detection = detect(image, frame.t_capture_ns)
                height, width = image.shape[:2]
                since_ns = seen_ns(ring.changed_ns(frame.slot), width, height, detection.circle)
                marker = detection.circle is not None or detection.predicted is not None
                picture = meter.measure(image, frame.t_capture_ns, marker=marker)
            if not ring.holds(frame.slot, frame.generation):
                detection = None
        link.send(Looked(frame.seq, detection, since_ns, picture))
