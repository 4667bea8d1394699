"""Put another version of the gateway into service, proven in operation, or go back by itself. As root.

  signature > install beside > check and migrate the configuration > replay the last day's recordings > wait until no
  truck is in any bay > switch > prove in operation, or return to the version before

A power cut at any point leaves one of the two versions running; the unit loading-gateway-update goes on from there.

examples:
  gateway update loading-gateway_0.2.0_amd64.deb            its signature: the same name with .asc
  gateway update loading-gateway_0.2.0_amd64.deb --check    everything up to the switch; dpkg keeps the package
  gateway update --status                                   what runs, what is under way, what came of it
  gateway update --back                                     to the version before; ends an update that is under way
exit codes: 0 done, 1 abandoned or returned, 2 an argument or a file must be edited
"""

import argparse
import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from gateway.config.strict.toml_file import read_toml
from gateway.errors import ConfigError, LinkError
from gateway.systemd import Notifier
from gateway.update import prepare, proof, requested, watcher
from gateway.update import state as states
from gateway.update.finish import log_to
from gateway.update.machine import Machine, UpdateError
from gateway.update.migrations import migrated
from gateway.update.prepare import UpdateOptions
from gateway.update.state import Outcome, Report, Stage, UpdateState

FOLLOW_S = 0.5
LOCK_TRIES = 50  # whoever looks whether a process works on the update holds the lock for a moment
LOST_S = 60.0  # without a process that works on the update
LOG_LINES = 12


def configure(parser: argparse.ArgumentParser) -> None:
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("package", type=Path, nargs="?", metavar="PACKAGE.deb", help="the new version")
    what.add_argument("--status", action="store_true", help="show versions, and the update that is under way")
    what.add_argument("--back", action="store_true", help="return to the version before; stop an update under way")
    what.add_argument("--resume", action="store_true", help="go on; called by the unit loading-gateway-update")
    what.add_argument("--requested", action="store_true", help="do what the page asks; called by its unit")
    what.add_argument("--migrate", type=Path, nargs=2, metavar=("OLD.toml", "NEW.toml"),
                      help="write a configuration as this version wants it")  # fmt: skip
    parser.add_argument("--check", action="store_true", help="dry run: up to the switch; dpkg keeps the package")
    parser.add_argument("--signature", type=Path, metavar="FILE", help="default: PACKAGE.deb.asc")
    parser.add_argument("--unsigned", action="store_true", help="install a package without a signature; it is logged")
    parser.add_argument("--yes", action="store_true", help="accept that the new version decides otherwise")
    parser.add_argument("--replay", type=float, default=24.0, metavar="H", help="hours of recordings (24); 0: none")
    parser.add_argument("--wait", type=float, default=3600.0, metavar="S", help="for free bays at most (3600)")
    parser.add_argument("--now", action="store_true", help="do not wait for free bays")
    parser.add_argument("--within", type=float, default=120.0, metavar="S", help="the proof must begin within (120)")
    parser.add_argument("--steady", type=float, default=45.0, metavar="S", help="and hold for this time (45)")
    parser.add_argument("--accept-alarm", action="append", default=[], metavar="ID",
                        help="an alarm that may be new after the update; may be repeated")  # fmt: skip


def main(args: argparse.Namespace) -> int:

    if args.migrate is not None:
        return _migrate(*args.migrate)
    return run(args, Machine())


def run(args: argparse.Namespace, machine: Machine) -> int:
    """`main` on a given machine. Raises ConfigError, UpdateError."""

    if os.geteuid() != 0 and machine.paths.root == Path("/"):
        raise ConfigError("gateway update: only root can do this: use sudo")
    if args.status:
        return _show_status(machine)
    report = log_to(machine, lambda line: print(line, flush=True))
    if args.resume:
        return _resume(machine, report)
    if args.requested:
        return _requested(machine, report)
    return _update(machine, _options(args), report, accept=args.yes)


def _options(args: argparse.Namespace) -> UpdateOptions:

    for name, low, high in (("replay", 0, 24 * 31), ("wait", 0, 86_400), ("within", 10, 3600), ("steady", 5, 3600)):
        if not low <= getattr(args, name) <= high:
            raise ConfigError(f"--{name} {getattr(args, name):g}: must be from {low} to {high}")
    return UpdateOptions(
        package=None if args.back else args.package.resolve(),
        signature=None if args.signature is None else args.signature.resolve(),
        unsigned=args.unsigned,
        dry=args.check,
        hours=args.replay,
        wait_s=args.wait,
        within_s=args.within,
        steady_s=args.steady,
        at_once=args.now,
        accepted=tuple(args.accept_alarm),
    )


def _update(machine: Machine, options: UpdateOptions, report: Report, *, accept: bool, follow: bool = True) -> int:

    def confirm(question: str) -> bool:
        if accept or not sys.stdin.isatty():
            return accept
        try:
            return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
        except EOFError:  # Ctrl-D
            print()
            return False

    if options.package is None and _under_way(states.read(machine)):
        machine.stop_watcher()
        with machine.lock() as ours:
            if not ours:
                raise UpdateError("another process works on an update: end it first, see gateway update --status")
            state = watcher.cancel(machine, report, "ended by hand")
        if state is None or state.stage is Stage.ENDED:
            return 0
    else:
        with machine.lock() as ours:
            if not ours:
                raise UpdateError("an update is under way: gateway update --status; --back ends it")
            state = prepare.prepare(machine, options, confirm, report)
        if state.stage is Stage.ENDED:
            return 0 if options.dry and state.why == prepare.DRY else 1
    _, read_from = _logged(machine, 0)
    machine.start_watcher()
    if not follow:
        return 0
    return _follow(machine, read_from, returning=state.stage is Stage.RETURNING)


def _requested(machine: Machine, report: Report) -> int:
    """What the page asks for; the watcher goes on alone. Its refusal stands in the log, which the page shows."""

    try:
        options = requested.taken(machine)
        code = _update(machine, options, report, accept=False, follow=False)
    except UpdateError as error:
        report(f"the page's request is refused: {error}")
        return 1
    if (state := states.read(machine)) is None or state.outcome is not Outcome.ABANDONED:
        requested.clean(machine)  # else the same package may be asked for again, with something accepted
    return code


def _under_way(state: UpdateState | None) -> bool:

    return state is not None and state.stage is not Stage.ENDED


def _follow(machine: Machine, read_from: int, *, returning: bool) -> int:
    """Show what the watcher says until it has ended; it does not need anybody to look on."""

    lost_since_s: float | None = None
    try:
        while True:
            state = states.read(machine)
            text, read_from = _logged(machine, read_from)
            print(text, end="", flush=True)
            if state is None or not _under_way(state):
                break
            with machine.lock() as free:
                lost_since_s = (machine.now_s() if lost_since_s is None else lost_since_s) if free else None
            if lost_since_s is not None and machine.now_s() - lost_since_s > LOST_S:
                print("nothing works on the update: look at systemctl status loading-gateway-update", file=sys.stderr)
                return 1
            machine.sleep(FOLLOW_S)
    except KeyboardInterrupt:
        print("\nit goes on without you: gateway update --status shows it, gateway update --back ends it")
        return 1
    good = Outcome.RETURNED if returning else Outcome.UPDATED
    return 0 if state is not None and state.outcome is good else 1


def _logged(machine: Machine, read_from: int) -> tuple[str, int]:
    """What the log has from there on, and where it ends. A log that can't be read ends nothing."""
    try:
        with machine.paths.log.open(encoding="utf-8", errors="replace") as log:
            log.seek(read_from)
            return log.read(), log.tell()
    except OSError:
        return "", read_from


def _resume(machine: Machine, report: Report) -> int:

    with Notifier.of_environment() as notifier, machine.lock(LOCK_TRIES) as ours:
        if not ours:
            raise UpdateError("another process works on the update")
        watcher.resume(machine, report, lambda: notifier.send(READY="1"))
    return 0


def _show_status(machine: Machine) -> int:

    print(f"in use:    {machine.version()}")
    print(f"installed: {', '.join(machine.installed())}")
    try:
        status = machine.status()
        print(f"running:   {status.version}, process {status.pid}; {proof.phases_in_words(status)}")
    except LinkError as error:
        print(f"running:   not known: {error}")
    state = states.read(machine)
    if state is None:
        print("update:    none so far")
        return 0
    print(f"previous:  {state.previous or 'none'}")
    began = datetime.fromtimestamp(state.began_unix_s, UTC)
    begun = f"           begun {began:%Y-%m-%d %H:%M:%S} UTC, {'back by hand' if state.by_hand else 'with a package'}"
    if state.stage is Stage.ENDED:
        outcome = "" if state.outcome is None else state.outcome.value.replace("_", " ")
        print(f"update:    from {state.old} to {state.new or '?'}: {outcome}{f': {state.why}' if state.why else ''}")
        print(begun)
    else:
        print(f"update:    from {state.old} to {state.new or '?'}: {state.stage.value}: {state.stage.meaning}")
        print(begun)
        with machine.lock() as free:
            if free:
                print("           no process works on it: systemctl start loading-gateway-update")
    if machine.paths.log.is_file():
        print("log:")
        lines = machine.paths.log.read_text(encoding="utf-8", errors="replace").splitlines()
        print("\n".join(f"  {line}" for line in lines[-LOG_LINES:]))
    return 0


def _migrate(old: Path, new: Path) -> int:
    """Nothing is written where nothing is to be changed."""

    _, text = read_toml(old)
    changed, lines = migrated(text, source=str(old))
    for line in lines:
        print(line)
    if lines:
        new.write_text(changed, encoding="utf-8")
    else:
        print("no key has another name in this version")
    return 0
