"""Propose red thresholds for the paper's method, and changes at the camera, from examples.

Examples are pictures in which you mark where the marker is:
  gateway tune --labels photos/labels.jsonl             as for gateway evaluate; found = false: without a marker
  gateway tune bay.png --at bay.png:412,300,96          centre and radius clicked, px; --at may be repeated
  gateway tune bay.png --at 412,300,96                  with one picture its name may be left out
  gateway tune photos/                                  no labels: the robust method's confident answers replace them

  gateway tune --labels photos/labels.jsonl --out red.toml --report tune.html
  gateway tune --labels photos/labels.jsonl --config plant.toml      measured against the plant's present settings

What you get: [vision] with both ranges of Table I, min_area_px2 and the shape gates, each bound with the range in
which it does as well; histograms of marker, surroundings (1.2 to 2.5 R) and background; whether the present setting
is too broad (it lets in what the marker would merge with; S >= 43 admits wood and rust) or too narrow; what the
paper's method finds in the examples before and after; and advice on exposure, noise, blur and white balance.

Take examples in every light there is: bright, dusk, lamps, dust, a wet marker. A setting is as good as its examples.
The robust method does not use these thresholds; for it the camera's part is what counts.

exit codes: 0 done, 1 no thresholds find a marker where the examples have one: nothing is proposed, 2 an argument, a
label or a picture must be changed
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gateway.cli import vision_args
from gateway.cli.tables import console, show
from gateway.config import VisionConfig
from gateway.errors import ConfigError, GatewayError
from gateway.vision.detect import registry
from gateway.vision.offline import inputs
from gateway.vision.offline.evaluation import labels, runner
from gateway.vision.offline.evaluation.labels import Label, outside
from gateway.vision.offline.reports.page import write
from gateway.vision.offline.tuning import exposure, histograms, proposal, report, thresholds
from gateway.vision.offline.tuning.study import Study, study
from gateway.vision.pixels import Image

CONFIDENT = 0.5
_NO_PROPOSAL = "# Nothing is proposed: with no thresholds is a marker found where the examples have one.\n"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("inputs", nargs="*", metavar="IMAGE", help="file, folder or pattern")
    parser.add_argument("--labels", type=Path, metavar="FILE.jsonl", help="labels with their pictures beside them")
    parser.add_argument(
        "--at", action="append", default=[], metavar="[FILE:]U,V,R", help="where the marker is; repeatable"
    )
    parser.add_argument("--config", metavar="FILE", type=Path, help="the present settings (default: the paper's)")
    parser.add_argument("--bay", metavar="NAME", help="which bay of it (default: the first)")
    parser.add_argument("--out", type=Path, metavar="FILE.toml", help="write the proposal to this file")
    parser.add_argument(
        "--report", type=Path, metavar="FILE.html", help="write histograms and figures as one HTML file"
    )


def main(args: argparse.Namespace) -> int:
    """Raises ConfigError for arguments, labels and pictures that must be changed, GatewayError without a proposal."""
    params = vision_args.bay_vision(args.config, args.bay)
    examples = _Examples(args, params)
    with vision_args.progress("tune", 3 * len(examples.labels)) as advance:
        found = study(examples.labels, examples.read, params, advance)
    marked = sum(example.marked for example in found.examples)
    missed = [outcome.label.file for outcome in found.found if outcome.label.found and not outcome.on_target]
    useless = not any(outcome.on_target for outcome in found.found)
    text = _NO_PROPOSAL if useless else proposal.toml(found.proposed, found.margins, found.gates, marked)
    text += proposal.robust(found.examples)
    if args.out is not None and not useless:
        write(args.out, text)
    if args.report is not None:
        settings = f"present settings: {args.config or 'the paper'}"
        facts = (f"{len(found.examples)} pictures, {marked} with a marker; {settings}",)
        write(args.report, report.html(found, text, facts, examples.notes))
    _show(found, examples.notes)
    print(f"\n{text}", end="")
    for path in (None if useless else args.out, args.report):
        if path is not None:
            print(f"written: {path}", file=sys.stderr)
    names = f"{', '.join(missed[:5])}{' ...' * (len(missed) > 5)}"
    if useless:
        raise GatewayError(f"no thresholds find a marker in {names}: is it where you marked it?")
    if missed:
        print(f"warning: not found with the proposal: {names}; is the marker where you marked it?", file=sys.stderr)
    return 0


class _Examples:
    """Labels from any source, and their pictures. Raises ConfigError."""

    def __init__(self, args: argparse.Namespace, params: VisionConfig) -> None:
        self.notes: list[str] = []
        self._paths: dict[str, Path] = {}
        self.labels: list[Label] = []
        if args.labels is not None:
            self._from_file(args.labels)
        clicked = _clicks(args.at, args.inputs)
        for name, place in clicked.items():
            self._add({"file": name, "found": True, **place}, Path(name))
        rest = [path for path in _expand(args.inputs) if str(path) not in self._paths]
        if rest and not self.labels:
            self._from_answers(rest, params)
        elif rest:
            names = ", ".join(path.name for path in rest[:5])
            print(f"warning: not processed: {names}{' ...' * (len(rest) > 5)}", file=sys.stderr)
        if not any(label.found for label in self.labels):
            raise ConfigError("gateway tune: no example with a marker; name pictures with --labels or --at")

    def read(self, label: Label) -> Image:
        return self._decode(self._paths[label.file])

    def _from_file(self, path: Path) -> None:

        found = labels.load_file(path)
        for label in found.labels:
            runner.picture(found, label)  # its size is checked against the label's place
            self.labels.append(label)
            self._paths[label.file] = found.path(label)

    def _from_answers(self, paths: Sequence[Path], params: VisionConfig) -> None:

        find = registry.detector(params.model_copy(update={"method": "robust", "tracking": False}))
        with vision_args.progress("search for markers", len(paths)) as advance:
            for path in paths:
                found = find(self._decode(path))
                rim = found.ellipse
                if found.circle is not None and (found.confidence or 0) >= CONFIDENT:
                    c = found.circle
                    place = {"u": c.u_px, "v": c.v_px, "r": c.radius_px}
                    axes = {"a": rim.semi_major_px, "b": rim.semi_minor_px} if rim else {}
                    self._add({"file": str(path), "found": True, **place, **axes}, path)
                advance()
        if not self.labels:
            raise ConfigError(
                f"gateway tune: no marker was found with confidence in {len(paths)} pictures; give its place with --at"
            )
        self.notes.append(
            f"no labels: the robust method's own confident answers in {len(self.labels)} of {len(paths)} pictures were "
            "taken for the truth; view them (gateway detect --method robust) before you trust this"
        )

    def _add(self, data: dict[str, object], path: Path) -> None:

        label = Label.model_validate(data)
        image = self._decode(path)
        if wrong := outside(label, image.shape[1], image.shape[0]):
            raise ConfigError(f"{path}: {wrong}")
        self.labels.append(label)
        self._paths[label.file] = path

    @staticmethod
    def _decode(path: Path) -> Image:

        try:
            return next(inputs.read(path)).image
        except inputs.InputError as error:
            raise ConfigError(f"{path}: {error}") from error


def _expand(names: Sequence[str]) -> list[Path]:

    return inputs.expand(names) if names else []


def _clicks(texts: Sequence[str], names: Sequence[str]) -> dict[str, dict[str, float]]:
    """File -> u, v, r of every --at."""
    found: dict[str, dict[str, float]] = {}
    for text in texts:
        name, _, numbers = text.rpartition(":")
        try:
            u, v, r = (float(part) for part in numbers.split(","))
        except ValueError:
            raise ConfigError(f"--at {text}: expected FILE:U,V,R, as bay.png:412.5,300,96") from None
        if not 0.5 <= r <= 100_000 or not abs(u) + abs(v) < 1e6:
            raise ConfigError(f"--at {text}: the radius must be 0.5 px or more, and the centre a number")
        if not name:
            if len(names) != 1:
                raise ConfigError(f"--at {text}: with {len(names)} pictures name the one that is meant: FILE:U,V,R")
            name = names[0]
        path = str(Path(name))
        if path in found:
            raise ConfigError(f"--at {text}: {path} was named before; one marker a picture")
        found[path] = {"u": u, "v": v, "r": r}
    return found


def _show(study: Study, notes: Sequence[str]) -> None:

    for note in notes:
        print(f"note: {note}")
    for line in histograms.lines(study.examples, study.proposed):
        print(line)
    for title, admits, red in (
        ("present setting", study.admits_now, study.now),
        ("proposal", study.admits_proposed, study.proposed),
    ):
        print(
            f"{title}: {100 * admits.marker:.1f} % of the markers pass (worst {100 * admits.marker_worst:.1f} %), "
            f"{100 * admits.ring:.2f} % of their surroundings, and elsewhere {admits.far_markers:.2f} times their area"
        )
        for remark in thresholds.remarks(admits, red):
            print(f"  {remark}")
        if admits.marker_worst < 0.8:
            worst = next(e for e in study.examples if e.marked and e.name == admits.worst_name)
            print(f"  what cuts it most: {thresholds.bound_that_cuts(red, worst)}")
    for table in (report.background(study), report.effect(study)):
        show(console(), table)
    for line in exposure.advice(study.lights):
        print(f"camera: {line}")
