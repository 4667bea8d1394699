"""An archive back onto a machine: checked first, then written beside what is there, then renamed. IO.

Nothing that exists is lost: what is replaced stays beside the new file under another name. A bay file is written only
where there is none: the state of a bay is that of now, and a function check that is on must not end by a restore.
"""

import grp
import os
import pwd
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from gateway import bay_file, systemd
from gateway.backup import archive, contents
from gateway.backup.archive import CHUNK, Readable
from gateway.backup.manifest import BackupError, Entry, Kind, Manifest, Owned
from gateway.config import GatewayConfig, parse
from gateway.config.strict.toml_file import read_toml
from gateway.files import sync_folder
from gateway.records import recorder_service as records
from gateway.shared_state import SharedStateWriter
from gateway.web.testsets.folder import folder_of as test_sets_folder
from gateway.web.testsets.folder import is_part

SYSTEM_FOLDER = Path("/etc/loading-gateway")  # of an installed gateway's configuration
Check = Callable[[GatewayConfig, str, str], None]  # the configuration, its path and its text; raises ConfigError
# Of nobody's password, where the archive has none: a configuration with it can be read.
_NO_HASH = "$argon2id$v=19$m=19456,t=2,p=1$AAAAAAAAAAAAAAAAAAAAAA$" + "A" * 43
_MOST = {
    Kind.CONFIGURATION: 0o660,
    Kind.CERTIFICATE: 0o664,
    Kind.SECRET: 0o640,
    Kind.STATE: 0o600,
    Kind.RECORD: 0o600,
    Kind.TEST_SET: 0o600,
    Kind.LANGUAGE: 0o664,
    Kind.KEYRING: 0o644,
}


@dataclass(slots=True)
class Plan:
    """What a restore would do. `faults`: why it can't; `notes`: what people should know."""

    manifest: Manifest
    config: GatewayConfig
    new: list[Entry] = field(default_factory=list)
    replaced: list[Entry] = field(default_factory=list)
    kept: list[Entry] = field(default_factory=list)  # equal already, or a bay file that is there
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def plan(path: Path, check: Check, *, force: bool, outside: bool) -> Plan:
    """Reads and checks all of an archive, and writes nothing but a temporary folder of one's own.

    `outside`: files may also be written elsewhere than below the gateway's own folder for its state and the folder of
    the configuration. Root's is SYSTEM_FOLDER: the archive chooses where its configuration lies, which must not be
    anywhere on the machine. Raises BackupError for an archive that is
    damaged, ConfigError for a configuration that this version refuses.
    """
    manifest = archive.verify(path)
    with tempfile.TemporaryDirectory(prefix="gateway-restore-") as folder:
        staged = _staged(path, manifest, Path(folder))
        document, text = read_toml(staged[manifest.config])
        if manifest.secrets:
            config = parse(document, source=manifest.config, text=text)
            check(_with_paths(config, staged), manifest.config, text)
        else:  # certificates without their keys can't be checked
            config = parse(_with_some_hash(document), source=manifest.config)
    made = Plan(manifest, config)
    belongs = _belonging(config, manifest)
    roots = (SYSTEM_FOLDER if os.geteuid() == 0 else Path(manifest.config).parent, systemd.default_folder())
    for entry in manifest.files:
        place = Path(entry.path)
        if not belongs(entry):
            made.faults.append(f"{place}: the configuration of the archive names no such file")
        elif not outside and not any(_real(place).is_relative_to(_real(root)) for root in roots):
            made.faults.append(f"{place}: lies outside {roots[0]} and {roots[1]}; --outside writes it")
        else:
            _sort(made, entry, place, force=force)
    made.notes += [
        f"{entry.path}: packages that are signed with these keys can be installed by root: know whose archive this is"
        for entry in (*made.new, *made.replaced)
        if entry.kind is Kind.KEYRING
    ]
    if os.geteuid() == 0:
        strangers = {name for entry in manifest.files for name in _unknown(entry.owned)}
        made.notes += [f"{name!r} is no user or group here: its files stay root's" for name in sorted(strangers)]
    if not manifest.secrets:
        made.notes += [f"not in the archive: {what}" for what in manifest.left_out]
        made.notes.append(f"{manifest.config}: passwords in it are ***: set them before the gateway is started")
    return made


def write(path: Path, made: Plan) -> list[Path]:
    """Carries it out: all or nothing as far as a file system can. Returns where the former files are now. Raises
    BackupError, and ConfigError where a gateway of this name runs."""
    wanted = {entry.member: entry for entry in (*made.new, *made.replaced)}
    stamp = f"{datetime.now():%Y%m%dT%H%M%S}"
    with _no_gateway_runs(made.config), ExitStack() as unfinished:
        fresh: dict[str, Path] = {}
        try:
            for entry, data in archive.files(path, made.manifest):
                if entry.member in wanted:
                    fresh[entry.path] = _written(entry, data, unfinished)
            aside = _renamed([(fresh[entry.path], Path(entry.path)) for entry in _in_order(wanted.values())], stamp)
        except OSError as error:
            raise BackupError(f"{error.filename or path}: cannot be written: {error.strerror or error}") from error
    return aside


def _staged(path: Path, manifest: Manifest, folder: Path) -> dict[str, Path]:
    """The files that the check reads, by the path where they will be."""
    staged: dict[str, Path] = {}
    for number, (entry, data) in enumerate(archive.files(path, manifest)):
        if entry.kind in (Kind.CONFIGURATION, Kind.CERTIFICATE, Kind.SECRET):
            staged[entry.path] = folder / str(number)
            fd = os.open(staged[entry.path], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(fd, "wb") as file:
                _copied(entry, data, file)
    return staged


def _with_paths(config: GatewayConfig, staged: Mapping[str, Path]) -> GatewayConfig:
    """The configuration with the staged files in the place of those it names."""
    names = {name for _, name, _ in contents.named_files(config)}

    def changed(value: Any) -> Any:
        match value:
            case dict():
                return {key: changed(inner) for key, inner in value.items()}
            case list() | tuple():
                return [changed(inner) for inner in value]
            case str() if value in names and (found := staged.get(str(Path(value).absolute()))) is not None:
                return str(found)
        return value

    return GatewayConfig.model_validate(changed(config.model_dump(mode="json", exclude_unset=True)))


def _with_some_hash(document: dict[str, Any]) -> dict[str, Any]:
    pages = document.get("hmi", {})
    users = [{**user, "password_hash": _NO_HASH} for user in pages.get("users", [])]
    return {**document, "hmi": {**pages, "users": users}}


def _belonging(config: GatewayConfig, manifest: Manifest) -> Callable[[Entry], bool]:
    """Has this configuration a use for a file of this kind at this path?"""
    named = {manifest.config, *(str(Path(name).absolute()) for _, name, _ in contents.named_files(config))}
    state = [path_of(config, bay.name) for path_of in (bay_file.path_of, bay_file.tried_path_of) for bay in config.bays]
    states = {str(path.absolute()) for path in state if path is not None}

    def of_bay(folder: Path | None, place: Path) -> bool:
        return folder is not None and place in {(folder / bay.name).absolute() for bay in config.bays}

    def belongs(entry: Entry) -> bool:
        path = Path(entry.path)
        match entry.kind:
            case Kind.KEYRING:
                return path == Path(manifest.config).with_name(contents.KEYRING)
            case Kind.LANGUAGE:
                folder = config.hmi.languages_folder
                return folder is not None and path.parent == Path(folder).absolute() and contents.is_language(path)
            case Kind.TEST_SET:
                return of_bay(test_sets_folder(config), path.parent.parent) and is_part(path)
            case Kind.RECORD:
                return of_bay(records.folder_of(config), path.parent) and contents.is_record(path.name)
            case Kind.STATE:
                return entry.path in states
        return entry.path in named

    return belongs


def _sort(made: Plan, entry: Entry, place: Path, *, force: bool) -> None:
    """Into what is new, replaced or kept; or a fault."""
    if place.is_symlink() or (place.exists() and not place.is_file()):
        made.faults.append(f"{place}: is a link or a folder on this machine; remove it first")
    elif entry.kind is Kind.RECORD and place.parent.is_dir() and not _holds(place, entry) and _has_records(place):
        made.faults.append(f"{place.parent}: has recordings of its own; move them away first")
    elif entry.kind is Kind.TEST_SET and place.parent.is_dir():
        made.kept.append(entry)
        note = f"{place.parent}: stays as it is: pictures and labels of two test sets are not mixed"
        if not _holds(place, entry) and note not in made.notes:
            made.notes.append(note)
    elif not place.exists():
        made.new.append(entry)
    elif _holds(place, entry):
        made.kept.append(entry)
    elif entry.kind is Kind.STATE:
        made.kept.append(entry)
        made.notes.append(f"{place}: stays as it is: the state of a bay is that of now")
    elif not made.manifest.secrets:
        made.faults.append(f"{place}: exists; an archive without secrets replaces nothing")
    elif force:
        made.replaced.append(entry)
    else:
        made.faults.append(f"{place}: exists, with other contents; --force replaces it, and keeps it beside")


def _has_records(place: Path) -> bool:
    return any(contents.is_record(name) for name in os.listdir(place.parent))


def _holds(place: Path, entry: Entry) -> bool:
    """Is the file there already?"""
    try:
        if place.stat().st_size != entry.bytes:
            return False
        digest = sha256()
        with place.open("rb") as file:
            while chunk := file.read(CHUNK):
                digest.update(chunk)
    except OSError:
        return False
    return digest.hexdigest() == entry.sha256


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))


@contextmanager
def _no_gateway_runs(config: GatewayConfig) -> Iterator[None]:
    """None of this name now, and none can start meanwhile. Raises ConfigError."""
    with ExitStack() as held:
        for bay in config.bays:
            held.enter_context(SharedStateWriter(config.instance, bay.name))
        yield


def _written(entry: Entry, data: Readable, unfinished: ExitStack) -> Path:
    """A new file beside its place, on the disk, with its owner; removed unless it is renamed. Raises OSError."""
    place = Path(entry.path)
    _folder(place.parent, entry.folder)
    handle, name = tempfile.mkstemp(prefix=f".{place.name}.", dir=place.parent)
    unfinished.callback(Path(name).unlink, missing_ok=True)
    with os.fdopen(handle, "wb") as file:
        _copied(entry, data, file)
        file.flush()
        _give(handle, entry.owned)
        os.fchmod(handle, entry.owned.mode & _MOST[entry.kind])
        os.fsync(handle)
    return Path(name)


def _copied(entry: Entry, data: Readable, file: IO[bytes]) -> None:
    digest = sha256()
    while chunk := data.read(CHUNK):
        digest.update(chunk)
        file.write(chunk)
    if digest.hexdigest() != entry.sha256:
        raise BackupError(f"{entry.path}: the archive has changed while it was read")


def _folder(folder: Path, like: Owned) -> None:
    """Made where it is missing. Raises OSError."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    for one in reversed(missing):
        one.mkdir(mode=0o700)
        fd = os.open(one, os.O_RDONLY | os.O_DIRECTORY)
        try:
            _give(fd, like)
            os.fchmod(fd, like.mode & 0o750)
        finally:
            os.close(fd)


def _give(fd: int, owned: Owned) -> None:
    """To the user and group of these names, where this is root and they are known here."""
    if os.geteuid() != 0:
        return
    with suppress(KeyError):
        os.fchown(fd, pwd.getpwnam(owned.owner).pw_uid, -1)
    with suppress(KeyError):
        os.fchown(fd, -1, grp.getgrnam(owned.group).gr_gid)


def _unknown(owned: Owned) -> Iterator[str]:
    try:
        pwd.getpwnam(owned.owner)
    except KeyError:
        yield owned.owner
    try:
        grp.getgrnam(owned.group)
    except KeyError:
        yield owned.group


def _in_order(entries: Any) -> list[Entry]:
    """The configuration last: until then the one that was there is in force, with files that are there."""
    return sorted(entries, key=lambda entry: entry.kind is Kind.CONFIGURATION)


def _taken_back(former: Path, place: Path) -> None:
    former.replace(place)
    former.unlink(missing_ok=True)  # two names of one file are left as they are


def _renamed(pairs: list[tuple[Path, Path]], stamp: str) -> list[Path]:
    """All, or none: where one can't be renamed, those before are taken back. Raises OSError."""
    aside: list[Path] = []
    with ExitStack() as undo:
        for fresh, place in pairs:
            if place.exists():
                former = place.with_name(f"{place.name}.before-{stamp}")
                os.link(place, former)  # the place is never empty
                aside.append(former)
                undo.callback(_taken_back, former, place)
            else:
                undo.callback(place.unlink, missing_ok=True)
            fresh.replace(place)
        for folder in {place.parent for _, place in pairs}:
            sync_folder(folder)
        undo.pop_all()
    return aside
