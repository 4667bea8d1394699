"""Take every decision of a recording again: by the recorded settings, or by others before they go live.

Without --against the outputs must be the same at every step, and the registers bit for bit; the first places where they
are not are printed. With it, the table shows what the PLC would have been told otherwise.

examples:
  gateway replay /var/lib/loading-gateway/records/site1.gateway/bay1
  gateway replay bay1/00000042-20261123T031500Z.seg
  gateway replay bay1 --against new.toml --from 04:00     what would the new thresholds have decided, truck by truck?
  gateway replay bay1 --against new.toml --jobs 2         of a month, by two processes
  gateway replay /mnt/plants --against new.toml --results /mnt/results --dask tcp://10.0.0.5:8786
                                                of all recordings below that folder, by the workers of a Dask cluster
  gateway replay bay1 --frames                  what does vision find in the kept pictures now?
  gateway replay bay1 --frames --against new.toml     and with other settings of it?
exit code 1 when anything differs or is missing
"""

import argparse
from pathlib import Path

from gateway import config
from gateway.cli import batch_args, replay_decisions
from gateway.errors import ConfigError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", nargs="+", type=Path, metavar="RECORDING", help="folder of bays, or segments")
    parser.add_argument("--against", type=Path, metavar="TOML", help="decide by this configuration instead")
    parser.add_argument("--bay", metavar="NAME", help="of TOML; default: the bay of the recording's name")
    parser.add_argument("--from", dest="begin", metavar="TIME", help="as for `gateway why`; default: the beginning")
    parser.add_argument("--to", dest="end", metavar="TIME", help="default: the end")
    parser.add_argument("--complete", action="store_true", help="with --against: also the minutes of an empty bay")
    parser.add_argument("--frames", action="store_true", help="run vision anew on the kept pictures instead")
    batch_args.configure(parser, default="one for each core")
    parser.add_argument("--json", action="store_true", help="one JSON object, for programs")


def main(args: argparse.Namespace) -> int:
    if args.bay is not None and args.against is None:
        raise ConfigError("--bay names a bay of the configuration that --against gives: add --against TOML")
    if args.complete and (args.against is None or args.frames):
        raise ConfigError("--complete is for --against, without --frames: other replays are always complete")
    if args.frames and (args.begin is not None or args.end is not None):
        raise ConfigError("--frames judges every kept picture: leave out --from and --to")
    batch_args.check(args)
    if args.frames and (args.dask is not None or args.results is not None):
        raise ConfigError("--dask and --results are for decisions: leave them out with --frames")
    other = None if args.against is None else config.load(args.against)
    if args.frames:
        from gateway.cli import replay_frames  # noqa: PLC0415 - and with it OpenCV, which decisions do not need

        return replay_frames.run(args, other)
    return replay_decisions.run(args, other)
