"""How long a dead picture is taken for a live one, and how often a live one for a dead one, behind real encoders.

    .venv/bin/python -m bench.frozen                              # JPEG and MPEG-4 by OpenCV
    .venv/bin/python -m bench.frozen --ffmpeg /usr/bin/ffmpeg     # H.264 and rate-controlled MJPEG, too
    .venv/bin/python -m bench.frozen --live 3000 --only JPEG,     # longer live runs, for docs/vision-processes.md

A bay at 640 x 480, 25 frames a second, that stands still. "Dead": the sensor repeats one picture, a clock is inserted
behind it, and both are encoded anew; the share of the frames from 0.5 s after the freeze on that the gateway shows as
GOOD: believed, and the marker's tiles not older than 0.3 s. A frozen source is opened again after half a second, as
often as it must be. "Live": frames that are not GOOD, those whose marker is older than they, the longest run of these.
"""

import argparse
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np

from bench.dust import bays
from gateway.core.detection import Circle
from gateway.vision.pixels import Image
from gateway.vision.source.freshness import Freshness, FrozenFrameDetector, unchanged_since_ns

FPS, FRAME_NS = 25, 40_000_000
DEADLINE_NS, FROZEN_S = 300_000_000, 2.0  # fusion.vision_deadline_s, camera.frozen_s
LIVE_FRAMES = 50  # before the sensor dies
DEAD_FRAMES = 450
LABEL, BAY = next(bays(3, 1))
HEIGHT, WIDTH = BAY.shape[:2]
MARKER = Circle(LABEL.u or 0.0, LABEL.v or 0.0, LABEL.r or 0.0)
MARGIN_PX = 512
Frames = Iterable[Image]


def exposed(count: int, noise: float, *, light: float = 1.0, kept: float = 0.0) -> Iterator[Image]:
    """`light`: 0.1 is a night whose shadows are black; `kept`: of the frame before, by a camera's noise reduction."""
    chance = np.random.default_rng(7)
    pool = chance.standard_normal((HEIGHT + MARGIN_PX, WIDTH + MARGIN_PX, 3), dtype=np.float32) * noise / 2**0.5
    still = BAY.astype(np.float32) * light - (8 if light < 1 else 0)
    shown = still
    for _ in range(count):
        new = still  # and two windows of the pool: a single one would come again within some hundred frames
        for v, u in chance.integers(0, MARGIN_PX, (2, 2)):
            new = new + pool[v : v + HEIGHT, u : u + WIDTH]
        shown = kept * shown + (1 - kept) * new
        yield np.clip(np.rint(shown), 0, 255).astype(np.uint8)


SENSORS: dict[str, Callable[[int], Iterator[Image]]] = {
    "noise 0.3": lambda count: exposed(count, 0.3),
    "noise 1": lambda count: exposed(count, 1.0),
    "noise 3": lambda count: exposed(count, 3.0),
    "noise 1, reduced over 8 frames": lambda count: exposed(count, 1.0, kept=0.875),
    "night, noise 2": lambda count: exposed(count, 2.0, light=0.1),
}


def clock(image: Image, n: int, kind: str) -> Image:
    image = image.copy()
    text = f"2026-11-27 10:{n // 1500:02d}:{n // FPS % 60:02d}.{n % FPS * 40:03d}"
    font, white = cv2.FONT_HERSHEY_SIMPLEX, (255, 255, 255)
    match kind:
        case "seconds":
            cv2.putText(image, text[:-4], (6, 20), font, 0.55, white, 1)
        case "large":
            cv2.rectangle(image, (0, 0), (WIDTH, 70), (0, 0, 0), -1)
            cv2.putText(image, text, (6, 50), font, 1.5, white, 3)
        case "moving":
            for k in range(3):
                cv2.putText(image, text, (WIDTH - (n * 7 + k * 400) % 1200, 120 * (k + 1)), font, 1.2, white, 2)
    return image


CLOCKS = ("none", "seconds", "large", "moving")


def dead(kind: str, loop: int = 1) -> Iterator[Image]:
    """The last `loop` frames again and again."""
    shots = list(SENSORS["noise 1"](LIVE_FRAMES + loop))
    for n in range(LIVE_FRAMES + DEAD_FRAMES):
        yield clock(shots[n if n < LIVE_FRAMES else LIVE_FRAMES + (n - LIVE_FRAMES) % loop], n, kind)


def jpeg(frames: Frames, quality: int, *, bytes_wanted: int = 0) -> Iterator[Image]:
    """`bytes_wanted`: the quality follows, as with a camera that has a bit rate to keep; else it is as given."""
    for image in frames:
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if bytes_wanted and abs(len(data) - bytes_wanted) > bytes_wanted // 200:
            quality = int(np.clip(quality + (1 if len(data) < bytes_wanted else -1), 10, 95))
        yield decoded(cv2.imdecode(data, cv2.IMREAD_COLOR))


def wandering(frames: Frames) -> Iterator[Image]:
    """JPEG whose quality wanders by one step at random."""
    chance, quality = np.random.default_rng(2), 60
    for image in frames:
        quality = int(np.clip(quality + chance.integers(-1, 2), 50, 70))
        yield from jpeg([image], quality)


def film(frames: Frames, write: Callable[[Frames, Path], object], suffix: str) -> Iterator[Image]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film.{suffix}"
        write(frames, path)
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        while (read := capture.read())[0]:
            yield decoded(read[1])
        capture.release()


def by_opencv(frames: Frames, path: Path) -> None:
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, FPS, (WIDTH, HEIGHT))
    for image in frames:
        writer.write(image)
    writer.release()


def by_ffmpeg(program: str, codec: str) -> Callable[[Frames, Path], None]:
    def write(frames: Frames, path: Path) -> None:
        raw = f"-f rawvideo -pix_fmt bgr24 -s {WIDTH}x{HEIGHT} -r {FPS} -i -"
        command = [program, *f"-v error -y {raw} {codec}".split(), str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as running:
            assert running.stdin is not None
            for image in frames:
                running.stdin.write(image.tobytes())

    return write


def decoded(picture: object) -> Image:
    return np.asarray(picture, np.uint8)


X264 = "-c:v libx264 -preset veryfast -tune zerolatency -pix_fmt yuv420p"
CODECS = {
    "MJPEG, 4 Mbit/s": ("-c:v mjpeg -b:v 4M -maxrate 4M -bufsize 1M", "avi"),
    **{f"H.264 (x264), {r}bit/s": (f"{X264} -b:v {r} -maxrate {r} -bufsize {r} -g 25", "mkv") for r in ("1M", "4M")},
    "H.264 (x264), constant quality": (f"{X264} -crf 23 -g 50", "mkv"),
    "H.264 (OpenH264), 3 Mbit/s": ("-c:v libopenh264 -b:v 3M -g 25 -pix_fmt yuv420p", "mkv"),
}


def encoders(ffmpeg: str | None) -> dict[str, Callable[[Frames], Iterator[Image]]]:
    table: dict[str, Callable[[Frames], Iterator[Image]]] = {
        "none": iter,
        **{f"JPEG, quality {q}": partial(jpeg, quality=q) for q in (10, 15, 30, 90)},
        "JPEG, 45 kB a frame": lambda frames: jpeg(frames, 60, bytes_wanted=45_000),
        "JPEG, quality wanders from 50 to 70": wandering,
        "MPEG-4": lambda frames: film(frames, by_opencv, "mp4"),
    }
    for name, (codec, suffix) in CODECS.items() if ffmpeg else ():
        write = by_ffmpeg(ffmpeg or "", codec)
        table[name] = partial(film, write=write, suffix=suffix)
    return table


def judged(frames: Frames) -> Iterator[tuple[bool, bool]]:
    """Of each frame: is it GOOD; is its marker older than it."""
    detector, closed = FrozenFrameDetector(FROZEN_S), 0
    for n, image in enumerate(frames):
        if closed:
            closed -= 1
            yield False, True
            continue
        t_ns = n * FRAME_NS
        verdict = detector.judge(image, t_ns)
        age_ns = t_ns - unchanged_since_ns(detector.changed_ns, WIDTH, HEIGHT, MARKER)
        if verdict is Freshness.FROZEN:
            detector, closed = FrozenFrameDetector(FROZEN_S), FPS // 2
        yield verdict is Freshness.LIVE and age_ns <= DEADLINE_NS, age_ns > 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ffmpeg", help="the program; without it only what OpenCV can encode")
    parser.add_argument("--live", type=int, default=500, help="frames of each live run; default 500")
    parser.add_argument("--only", default="", help="encoders whose name contains this")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    chosen = {name: encode for name, encode in encoders(args.ffmpeg).items() if args.only in name}
    cases = [*((kind, 1) for kind in CLOCKS), ("seconds", 2), ("seconds", 100)]
    print("| dead, encoder |", *(f"{kind}{f', loop of {n}' if n > 1 else ''} |" for kind, n in cases))
    for name, encode in chosen.items():
        after = [list(judged(encode(dead(*case))))[LIVE_FRAMES + FPS // 2 :] for case in cases]
        print(
            f"| {name} |", *(f"{100 * np.mean([good for good, _ in frames]):.0f} % |" for frames in after), flush=True
        )
    print("\n| live, encoder | sensor | frames | not GOOD | older | longest run |")
    for name, encode in chosen.items():
        for sensor, frames in SENSORS.items():
            live = (clock(image, n, "seconds") for n, image in enumerate(frames(args.live)))
            looks = list(judged(encode(live)))[FPS // 2 :]
            runs = [len(list(run)) for old, run in groupby(old for _, old in looks) if old]
            bad = sum(not good for good, _ in looks)
            print(f"| {name} | {sensor} | {len(looks)} | {bad} | {sum(runs)} | {max(runs, default=0)} |", flush=True)


if __name__ == "__main__":
    main()
