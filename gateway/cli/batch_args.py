"""Shared by the verbs whose work several processes share: how many, of which machines, and where results are kept."""

import argparse
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from gateway.errors import ConfigError
from gateway.processes.batch import ThisProcess
from gateway.processes.batch_workers import DaskWorkers, LocalWorkers

MOST_JOBS = 256
AnyWorkers = ThisProcess | LocalWorkers | DaskWorkers


def configure(parser: argparse.ArgumentParser, *, default: str) -> None:
    parser.add_argument("--jobs", type=int, metavar="N", help=f"processes at most; default: {default}")
    parser.add_argument("--dask", metavar="ADDRESS", help="the workers of this Dask scheduler instead; needs --results")
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="keep results there, and take those that are")


def check(args: argparse.Namespace) -> None:
    """Raises ConfigError."""
    if args.jobs is not None and not 1 <= args.jobs <= MOST_JOBS:
        raise ConfigError(f"--jobs {args.jobs}: must be 1 to {MOST_JOBS}")
    if args.dask is not None and args.jobs is not None:
        raise ConfigError("--jobs is for this machine: leave it out with --dask")
    if args.dask is not None and args.results is None:
        raise ConfigError("--dask needs --results FOLDER, one that all workers see under this path")


@contextmanager
def workers(args: argparse.Namespace, module: str, default: int | None = None) -> Iterator[tuple[str, AnyWorkers, int]]:
    """The folder of results, who does the tasks of this module, and how many they are; None: one for each core.

    Raises ConfigError, LinkError."""
    jobs = args.jobs or default or len(os.sched_getaffinity(0))
    with TemporaryDirectory(prefix="gateway-results-") as temporary:
        results = temporary if args.results is None else str(args.results.absolute())
        if args.dask is not None:
            with closing(DaskWorkers(module, args.dask)) as remote:
                yield results, remote, remote.count
            return
        with closing(ThisProcess(module) if jobs == 1 else LocalWorkers(module, jobs)) as local:
            yield results, local, jobs
