"""All settings of the configuration's file for the settings page: shown without passwords, changed, checked completely,
saved. IO, on the file's thread.

Nothing is saved that this gateway would not start with: the new text passes the checks of `gateway check` first.
"""

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from gateway.bay_file import begin_with_function_check, folder_of
from gateway.config import SHARED_SECTIONS, BayConfig, GatewayConfig, VisionConfig, decision, parse
from gateway.config.live import changes
from gateway.config.strict.errors import ConfigFault, FaultsError
from gateway.config.strict.section import inner_model
from gateway.config.strict.toml_file import merge, parsed
from gateway.core.plc import Writer
from gateway.errors import ConfigError
from gateway.sinks import registry as sink_registry
from gateway.web.auth.audit_log import printable
from gateway.web.host import config_file
from gateway.web.host.camera_passwords import CameraPasswords
from gateway.web.host.startup import Startup
from gateway.web.ipc.messages import (
    CameraPasswordKept,
    ChangedOnDiskError,
    FileFault,
    KeepCameraPassword,
    MakeFirstUser,
    PreviewSettings,
    SaveSettings,
    SettingsDocument,
    SettingsPreview,
    SettingsSaved,
)
from gateway.web.profile import parameter_schema, profile, settings_model, stored_passwords
from gateway.web.profile.redact import HIDDEN, Fields, plainly
from gateway.web.profile.settings_edit import ChangeError, KeyPath, SettingChange, by_name, edited, path_of

log = logging.getLogger(__name__)

MAX_DIFF = 200_000  # characters
MAX_LOGGED = 10  # keys
NO_TECHNICIAN = (
    "no technician would be left, and nobody could open this page: make another one first, or change the file on the "
    "machine"
)
SWITCHED_OFF = "the settings page is switched off: hmi.setup_page = false"

Check = Callable[[GatewayConfig, str, str], None]
"""The gateway's checks of a configuration: settings, its file's name and text. Raises FaultsError."""


@dataclass(frozen=True)
class Planned:
    """The file with the changes made."""

    former: config_file.Loaded
    before: GatewayConfig  # the settings of the former text; those in force where that has faults
    text: str
    faults: tuple[FileFault, ...]
    settings: GatewayConfig | None = None  # None: there are faults


class SettingsFile:
    """`running`: the settings in force. `reload`: takes over what is live of a saved file; None: nothing is live.
    `in_force`: the keys of a bay's decision, with what a technician has applied."""

    def __init__(
        self,
        path: Path,
        running: Callable[[], GatewayConfig],
        startup: Startup,
        check: Check,
        reload: Callable[[], None] | None = None,
        in_force: Callable[[str], Mapping[str, Any]] = lambda _: {},
    ) -> None:
        self.path = path
        self._source = str(path)
        self._now = running
        self._startup = startup
        self._check = check
        self._reload = reload
        self._in_force = in_force
        self._camera_passwords = CameraPasswords()

    @property
    def _running(self) -> GatewayConfig:
        return self._now()

    @cached_property
    def _sinks(self) -> settings_model.Sinks:
        return sink_registry.known_sections(self._running)

    @cached_property
    def _fields(self) -> Fields:
        return settings_model.model_of(self._sinks).model_fields

    @cached_property
    def _schema(self) -> str:
        return json.dumps(settings_model.schema(self._sinks))

    def read(self) -> SettingsDocument:
        """Raises ConfigError."""
        self._permitted()
        loaded = config_file.load(self.path)
        document = parsed(loaded.text, self._source)
        settings, faults = self._checked(loaded.text)
        shown = None if settings is None else self._parsed(loaded.text, self._startup.file_overrides)
        return SettingsDocument(
            values="null" if shown is None else json.dumps(self._shown(_values(shown, document))),
            written=json.dumps(self._shown(document), default=str),
            schema=self._schema,
            digest=loaded.digest,
            path=self._source,
            why_not=config_file.why_not_writable(self.path),
            command_line=tuple(_leaves(self._startup.overrides)),
            faults=faults,
            waiting=() if settings is None else tuple(map(str, changes(self._running, settings))),
            undo=config_file.previous(self.path) is not None,
        )

    def waiting(self, bay: str) -> tuple[str, ...]:
        """The keys of the bay's decision that are in the file, and not in force: they wait for a restart. Empty, too,
        for a file that can't be read: no gateway starts with it."""
        try:
            settings = self._parsed(config_file.load(self.path).text, self._startup.overrides)
        except ConfigError:
            return ()
        loaded, saved = ({one.name: one for one in config.bays}.get(bay) for config in (self._running, settings))
        if saved is None or loaded is None:
            return ()
        new = decision.keys_of(saved, settings)
        changed = decision.differing(decision.keys_of(loaded, self._running), new)  # not what is applied, and not saved
        return tuple(key for key in decision.differing(self._in_force(bay), new) if key in changed)

    def preview(self, wanted: PreviewSettings, who: Writer) -> SettingsPreview:
        """Raises ConfigError, ChangedOnDiskError."""
        self._permitted()
        planned = self._planned(wanted)
        former = planned.former
        diff = profile.diff(former.text, planned.text, self._source, self._fields)
        live, restart = self._effects(planned)
        return SettingsPreview(
            diff=diff if len(diff) <= MAX_DIFF else f"{diff[:MAX_DIFF]}\n(and more)\n",
            faults=planned.faults,
            warnings=()
            if planned.settings is None
            else (*self._startup.warnings(planned.settings), *_own_login(planned.before, planned.settings, who)),
            live=live,
            restart=restart,
            digest=former.digest,
            why_not=config_file.why_not_writable(self.path),
            vision=self._tuned(planned),
        )

    def save(self, wanted: SaveSettings, who: Writer) -> SettingsSaved:
        """Raises ConfigError with every fault, ChangedOnDiskError."""
        self._permitted()
        planned = self._planned(wanted)
        if planned.faults:
            raise ConfigError("\n".join(f"{'.'.join(fault.path)}: {fault.message}" for fault in planned.faults))
        live, restart = self._effects(planned)
        self._begin_checks(planned)
        previous = config_file.save(planned.former, planned.text)
        if live and self._reload is not None:
            self._reload()
        keys = [".".join(change.path) for change in wanted.changes]
        what = "the last save undone" if wanted.undo else ", ".join(keys[:MAX_LOGGED])
        more = f" and {len(keys) - MAX_LOGGED} more" if len(keys) > MAX_LOGGED else ""
        log.info("%s: %s saved by %s", self._source, printable(f"{what}{more}", 400), printable(str(who)))
        return SettingsSaved(live, restart, config_file.load(self.path).digest, str(previous))

    def make_first_user(self, wanted: MakeFirstUser, who: Writer) -> SettingsSaved:
        """Raises ConfigError, ChangedOnDiskError. Anybody may read these: what the file has stands in the log alone."""
        try:
            return self.save(self._first_user(wanted), who)
        except ChangedOnDiskError:
            raise
        except ConfigError as error:
            log.error("%s: the first password was not made: %s", self._source, printable(str(error), 400))
            raise ConfigError("the configuration's file does not take it: the gateway's log says why") from None

    def _first_user(self, wanted: MakeFirstUser) -> SaveSettings:
        """Raises ConfigError where it would not be in force at once, ChangedOnDiskError where somebody was first."""
        if not self._running.hmi.first_password:
            raise ConfigError("hmi.first_password is not set")
        former = config_file.load(self.path)
        if self._running.hmi.users or parsed(former.text, self._source).get("hmi", {}).get("users"):
            raise ChangedOnDiskError("somebody else has made the first password meanwhile: log in")
        user = {"role": "technician", "password_hash": wanted.password_hash}
        made = SaveSettings((SettingChange(("hmi", "users", wanted.name), user),), former.digest)
        if self._effects(self._planned(made))[1]:
            raise ConfigError("the file has changes of [hmi] that wait for a restart: start the gateway again first")
        return made

    def keep_camera_password(self, wanted: KeepCameraPassword) -> CameraPasswordKept:
        """Raises ConfigError."""
        self._permitted()
        named = [config_file.load(self.path).text]
        if (former := config_file.previous(self.path)) is not None:
            named.append(former.text)
        kept = self._camera_passwords.keep(folder_of(self._running), wanted.url, wanted.password, named)
        return CameraPasswordKept(str(kept))

    def _begin_checks(self, planned: Planned) -> None:
        """A bay that is new starts under a function check: nobody has tried it. Raises ConfigError."""
        running = {bay.name for bay in self._running.bays}
        for bay in () if planned.settings is None else planned.settings.bays:
            if planned.settings is not None and bay.name not in running:
                try:
                    begin_with_function_check(planned.settings, bay)
                except OSError as error:
                    raise ConfigError(f"state_dir: {bay.name}'s function check can't be kept: {error}") from error

    def _permitted(self) -> None:
        if not self._running.hmi.setup_page:
            raise ConfigError(SWITCHED_OFF)

    def _planned(self, wanted: PreviewSettings | SaveSettings) -> Planned:
        former = config_file.load(self.path)
        if former.digest != wanted.digest:
            raise ChangedOnDiskError(f"{self.path}: was changed elsewhere since it was shown; nothing was written")
        before = self._checked(former.text)[0] or self._running
        try:
            text = self._undone() if wanted.undo else self._edited(former.text, wanted.changes)
        except ChangeError as error:
            return Planned(former, before, former.text, (FileFault(error.path, None, str(error)),))
        if sent := {} if wanted.undo else self._sent_elsewhere(former.text, text, wanted.changes):
            faults = tuple(FileFault(path, None, why) for path, why in sent.items())
            return Planned(former, before, text, faults)
        settings, faults = self._checked(text)
        about_users = wanted.undo or any(change.path[0] == "hmi" for change in wanted.changes)
        if about_users and settings is not None and _technicians(before) and not _technicians(settings):
            return Planned(former, before, text, (FileFault(("hmi", "users"), None, NO_TECHNICIAN),))
        return Planned(former, before, text, faults, settings)

    def _sent_elsewhere(self, former: str, text: str, changes: Sequence[SettingChange]) -> dict[KeyPath, str]:
        """What the changes would have done with passwords that nobody has typed."""
        before, after = (by_name(parsed(one, self._source)) for one in (former, text))
        typed = " ".join(_texts(change.value) for change in changes)
        return stored_passwords.faults(before, after, typed, self._camera_passwords.addresses)

    def _undone(self) -> str:
        found = config_file.previous(self.path)
        if found is None:
            raise ConfigError(f"{self.path}: there is no file of before the last save")
        return found.text

    def _edited(self, text: str, requested: Sequence[SettingChange]) -> str:
        """Raises ChangeError."""
        fixed = tuple(_leaves(self._startup.overrides))
        shown = self._shown(parsed(text, self._source))
        wanted: list[SettingChange] = []
        for change in requested:
            if any(change.path[: len(path)] == path for path in fixed):
                raise ChangeError(change.path, "is set on the command line, whatever the file says")
            if HIDDEN in _texts(change.value):
                if change.value == _at(shown, change.path):
                    continue  # as it was
                raise ChangeError(change.path, f"{HIDDEN} stands for what is not shown: write the complete value")
            wanted.append(change)
        return edited(text, wanted, source=self._source)

    def _checked(self, text: str) -> tuple[GatewayConfig | None, tuple[FileFault, ...]]:
        """As this gateway would start with it; its bays are checked also where the command line has others."""
        try:
            document = parsed(text, self._source)
        except ConfigError as error:
            return None, (FileFault((), None, str(error)),)
        try:
            self._check(self._parsed(text, self._startup.file_overrides), self._source, text.removeprefix("\ufeff"))
            return self._parsed(text, self._startup.overrides), ()
        except FaultsError as error:
            return None, tuple(_shown_fault(fault, document) for fault in error.faults)
        except ConfigError as error:
            return None, (FileFault((), None, str(error)),)

    def _parsed(self, text: str, overrides: Mapping[str, Any]) -> GatewayConfig:
        """Raises FaultsError, ConfigError."""
        document = merge(parsed(text, self._source), overrides)
        return parse(document, source=self._source, text=text.removeprefix("\ufeff"))

    def _effects(self, planned: Planned) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What the new text changes at once, and what at the next start."""
        if planned.settings is None:
            return (), ()
        found = changes(planned.before, planned.settings)
        waits = {change.path for change in changes(self._running, planned.settings) if not change.live}
        if self._reload is None:
            return (), tuple(map(str, found))
        live = tuple(str(change) for change in found if change.path not in waits)
        return live, tuple(str(change) for change in found if change.path in waits)

    def _tuned(self, planned: Planned) -> dict[str, VisionConfig]:
        """The settings of vision that the changes would give to running bays."""
        if planned.settings is None:
            return {}
        before = {bay.name: bay.vision for bay in planned.before.bays}
        running = {bay.name for bay in self._running.bays}
        return {
            bay.name: bay.vision
            for bay in planned.settings.bays
            if bay.name in running and parameter_schema.changes(before.get(bay.name, VisionConfig()), bay.vision)
        }

    def _shown(self, document: Mapping[str, Any]) -> dict[str, Any]:
        return by_name(plainly(document, self._fields))


def _technicians(settings: GatewayConfig) -> set[str]:
    """Who may open the settings page; empty name: anybody."""
    anybody = {""} if settings.hmi.without_login == "technician" else set()
    return anybody | {user.name for user in settings.hmi.users if user.role == "technician"}


def _own_login(before: GatewayConfig, after: GatewayConfig, who: Writer) -> Iterator[str]:
    left = _technicians(after)
    if who.subject in _technicians(before) - left and "" not in left:
        yield f"hmi.users: {who.subject}, who is you, is no technician then: only others can open this page afterwards"


def _values(settings: GatewayConfig, document: Mapping[str, Any]) -> dict[str, Any]:
    """Every key with its value, defaults included."""
    values = settings.model_dump(mode="json")
    values["sinks"] = {
        name.removeprefix("sinks."): section.model_dump(mode="json")
        for name, section in sink_registry.settings_of(settings)
    }
    for name in SHARED_SECTIONS:
        field = BayConfig.model_fields[name]
        model = inner_model(field.annotation)
        if field.default is None and name not in document:
            values[name] = None  # absent is off, and has no defaults in force
        elif model is not None:
            values[name] = model.model_validate(document.get(name, {})).model_dump(mode="json")
    return values


def _shown_fault(fault: ConfigFault, document: Mapping[str, Any]) -> FileFault:
    where = "" if fault.line or fault.where != "command line" else "set on the command line: "
    shown = f"{fault.shown.removeprefix(' = ')}: " if fault.shown else ""
    return FileFault(path_of(fault.place, document), fault.line, f"{where}{shown}{fault.message}")


def _leaves(tree: Mapping[str, Any], above: KeyPath = ()) -> Iterator[KeyPath]:
    """A list of tables is one: it takes the place of the file's."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*above, key))
        else:
            yield (*above, key)


def _at(tree: Any, path: KeyPath) -> Any:
    for part in path:
        tree = tree.get(part) if isinstance(tree, Mapping) else None
    return tree


def _texts(value: Any) -> str:
    """All text in it, to look for what is masked."""
    match value:
        case str():
            return value
        case Mapping():
            return " ".join(map(_texts, value.values()))
        case list() | tuple():
            return " ".join(map(_texts, value))
    return ""
