"""Which colours of a disc are taken for the marker: by hue and saturation, and paints, lamps, rust and skin by name.

    .venv/bin/python -m bench.colour                        # the default: the paper's red
    .venv/bin/python -m bench.colour --marker "#e7752a"     # another `vision.marker_colour`

Each disc stands on a plain grey ground and on the four busy ones of `tests.decoys`. A cell says on how many of them the
robust method takes it for the marker, with the highest confidence; on how many the paper's does; and whether one of the
reasons against it was its colour.
"""

import argparse
import colorsys
from collections.abc import Iterator

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.detect.geometry import same_place
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust import detect as robust
from gateway.vision.pixels import Image
from tests import decoys

WIDTH, HEIGHT = 320, 240
PLACE = Circle(161.3, 118.6, 42.0)
HUES_DEG = (-60, -50, -40, -30, -20, -10, 0, 10, 15, 20, 25, 30, 40, 50)
SATURATIONS = (1.0, 0.8, 0.5, 0.3, 0.2, 0.1, 0.05)
NAMED = {  # sRGB
    "marker (190, 35, 45)": (190, 35, 45),
    "RAL 3020 traffic red": (193, 18, 28),
    "RAL 3000 flame red": (167, 41, 32),
    "RAL 2002 vermilion": (198, 57, 39),
    "faded red": (200, 120, 116),
    "dusty red": (150, 85, 82),
    "dark red": (70, 15, 16),
    "RAL 2004 pure orange": (231, 91, 18),
    "RAL 2009 traffic orange": (222, 83, 7),
    "amber lamp": (255, 140, 30),
    "brown lid": (110, 60, 40),
    "rust": (128, 66, 44),
    "dark rust": (92, 52, 36),
    "light skin": (224, 172, 140),
    "dark skin": (141, 85, 64),
    "wood": (152, 96, 68),
    "brick": (150, 74, 56),
    "pale pink": (255, 192, 203),
    "deep pink": (255, 20, 147),
    "magenta": (200, 20, 200),
    "violet": (130, 40, 140),
    "yellow": (240, 200, 20),
    "blue": (30, 60, 180),
    "green": (30, 140, 60),
}
LIGHTS = {  # of blue, green, red
    "as it is": (1.0, 1.0, 1.0),
    "dim": (0.3, 0.3, 0.3),
    "bright": (1.5, 1.5, 1.5),
    "warm": (0.7, 0.93, 1.06),
    "cold": (1.1, 0.96, 0.76),
}


def pictures(rgb: tuple[float, float, float], light: tuple[float, float, float]) -> Iterator[Image]:
    for number, ground in enumerate(("plain", *decoys.GROUNDS)):
        sheet = decoys.sheet(WIDTH, HEIGHT, "concrete" if ground == "plain" else ground, 70 + number)
        if ground == "plain":
            sheet.paint[:] = 120
        sheet.disc(PLACE.u_px, PLACE.v_px, PLACE.radius_px, (rgb[2], rgb[1], rgb[0]))
        sheet.paint *= np.array(light, np.float32)
        yield sheet.finished()


def cell(rgb: tuple[float, float, float], params: VisionConfig, light: str = "as it is") -> str:
    best, taken, paper = 0.0, 0, 0
    refused: set[str] = set()
    for image in pictures(rgb, LIGHTS[light]):
        found = robust.detect(image, params)
        if found.circle is not None and same_place(found.circle, PLACE):
            taken += 1
            best = max(best, found.confidence or 0.0)
        else:
            refused |= {r.why for r in found.rejected if same_place(r.circle, PLACE)}
        by_paper = pipeline.detect(image, params)
        paper += by_paper.circle is not None and same_place(by_paper.circle, PLACE)
    return f"{taken} {best:.2f} / {paper} {'colour' if 'colour' in refused else ''}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--marker", help="`vision.marker_colour`; default: the paper's red")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    params = VisionConfig(marker_colour=args.marker)
    console = Console(width=150)
    by_hue = Table("hue, degrees", *(f"S {saturation:g}" for saturation in SATURATIONS), title="value 0.78")
    for hue_deg in HUES_DEG:
        row = []
        for saturation in SATURATIONS:
            red, green, blue = colorsys.hsv_to_rgb(hue_deg % 360 / 360, saturation, 0.78)
            row.append(cell((255 * red, 255 * green, 255 * blue), params))
        by_hue.add_row(f"{hue_deg:+d}", *row)
    console.print(by_hue)
    by_name = Table("disc", *LIGHTS)
    for name, rgb in NAMED.items():
        by_name.add_row(name, *(cell(rgb, params, light) for light in LIGHTS))
    console.print(by_name)


if __name__ == "__main__":
    main()
