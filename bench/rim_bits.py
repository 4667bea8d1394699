"""Is the rim's kernel the same to the last bit on another processor? `python -m bench.rim_bits`

Compiles it for this machine and, by `--compiler` and `--run`, for another, in an emulator; both refine the rims of the
same pictures, and what they print is compared. On Debian: gcc-aarch64-linux-gnu, libc6-dev-arm64-cross and qemu-user.
"""

import argparse
import shlex
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.scene import BEYOND, RECIPES, draw
from gateway.core.detection import Ellipse
from gateway.vision.compiled.build import EXACT, HERE, numbers
from gateway.vision.compiled.sizes import COARSE_RAYS, FALL_RAYS, LEAST_RAYS, MOST_RAYS, RAYS_STEP
from gateway.vision.detect.robust import rim_coarse
from gateway.vision.detect.robust.kernel import lab, rim_kernel
from gateway.vision.detect.robust.refinement import load

ROOM = Path(rim_kernel.__file__).parent


def part(data: bytes) -> bytes:
    return struct.pack("<q", len(data)) + data


def asked(pictures: int) -> bytes:
    """Tables and tasks as the program reads them."""
    kernel = load()
    if kernel is None:
        sys.exit("the vision kernels are not built: ./dev kernel")
    room = rim_kernel.Room(kernel.work_size)
    parts = [bytes(kernel.tables), rim_kernel.directions_of(COARSE_RAYS).tobytes()]
    counts = (FALL_RAYS, *range(LEAST_RAYS, MOST_RAYS + 1, RAYS_STEP))
    parts += [rim_kernel.directions_of(count).tobytes() for count in counts]
    parts.append(rim_coarse.edge_filter().tobytes())
    for rays, inverses in rim_coarse.subsets():
        parts += [rays.astype(np.int32).tobytes(), inverses.tobytes()]
    parts += [lab.linear().tobytes(), lab.root().tobytes()]
    tasks: list[bytes] = []
    for recipe in (*RECIPES, *BEYOND):
        for number in range(pictures):
            scene = draw(recipe, 500 + number, (12.0, 90.0))
            image, truth = scene.shot(), scene.truth()
            seed = Ellipse(truth.u + 0.3, truth.v, 1.01 * truth.major, truth.minor, truth.angle)
            for search_px in (3.0, 8.0):
                for opponent in (False, True):
                    kernel.run(room, image, seed, search_px, opponent)  # for the profiles that it needs
                    rim_kernel.set_task(room.task, image, seed, search_px, opponent)
                    room.task.stride = 3 * image.shape[1]
                    tasks += [bytes(room.task), image.tobytes()]
    parts += [room.keys.tobytes(), room.profiles.tobytes(), *tasks]
    return b"".join(map(part, parts))


def answers(main: Path, compiler: str, run: str, flags: list[str], tasks: Path) -> list[str]:
    """What the program of `main` and the kernels prints, line by line."""
    program = tasks.with_name("program")
    options = ["-O3", "-std=c11", *EXACT, *numbers(), *flags, f"-I{HERE}", f"-I{ROOM}"]
    subprocess.run(
        [*shlex.split(compiler), *options, "-o", program, main, *sorted(ROOM.glob("*.c")), "-lm"], check=True
    )
    done = subprocess.run([*shlex.split(run), program, tasks], check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def compared(main: Path, tasks_of: Callable[[int], bytes], about: str | None) -> list[str]:
    """Compare this machine with others, as the command line says; what this machine printed."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compiler", default="aarch64-linux-gnu-gcc -static", help="for the other processor")
    parser.add_argument("--run", default="qemu-aarch64", help="what runs its programs here")
    parser.add_argument("--pictures", type=int, default=4, help="of each kind (default 4)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tasks = Path(folder, "tasks")
        tasks.write_bytes(tasks_of(args.pictures))
        here = answers(main, "cc", "", [], tasks)
        others = {
            "plain loops here": answers(main, "cc", "", ["-DGATEWAY_NARROW"], tasks),
            args.compiler: answers(main, args.compiler, args.run, [], tasks),
        }
    for name, there in others.items():
        differ = sum(one != other for one, other in zip(here, there, strict=True))
        print(f"{name}: {differ} of {len(here)} differ from wide registers here")
    return here


def main() -> None:
    here = compared(Path(__file__).with_suffix(".c"), asked, __doc__)
    print(f"{sum(line.startswith('1 ') for line in here)} rims")


if __name__ == "__main__":
    main()
