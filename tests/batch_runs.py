"""A replay shared by processes, as the command line asks for it."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from gateway.processes.batch import ThisProcess
from gateway.processes.batch_workers import LocalWorkers
from gateway.records import replay_jobs
from gateway.records.replay_portions import Portion, ReplayRules


def replayed_by(jobs: int, rules: ReplayRules, paths: Sequence[str]) -> Portion:
    """One recording, by so many processes; 1: by this one."""
    module = replay_jobs.__name__
    workers = ThisProcess(module) if jobs == 1 else LocalWorkers(module, jobs)
    with TemporaryDirectory() as results, closing(workers):
        (found,) = replay_jobs.found_by(rules, [[Path(path) for path in paths]], results, workers, jobs)
    return found
