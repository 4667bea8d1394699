"""The settings page's addresses. `security` has checked who calls; the main process reads, checks and writes the
file."""

from msgspec import structs
from starlette.requests import Request

from gateway.errors import ConfigError
from gateway.web.auth.access import LOGIN_BYTES, Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.auth.audit_log import AuditKind, AuditRecord
from gateway.web.auth.logins import Logins
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller
from gateway.web.ipc.messages import (
    TRUCK_AT_BAY,
    MakeFirstUser,
    PreviewSettings,
    ReadSettings,
    RestartGateway,
    SaveSettings,
    SettingsDocument,
    SettingsPreview,
    SettingsSaved,
)
from gateway.web.profile.settings_edit import SettingChange
from gateway.web.server.gateway_client import RefusedError
from gateway.web.server.services import RequestCaller, Services, WebServices
from gateway.web.setup.models import (
    BootView,
    ChangesBody,
    FirstPasswordView,
    NewPasswordBody,
    NewPasswordView,
    PreviewView,
    RestartBody,
    RestartView,
    SaveChangesBody,
    SavedView,
    SettingsView,
)
from gateway.web.tuning import warning_gate

BODY_BYTES = 48 * 1024  # fits into one message to the main process
RESTART_S = 10.0  # from the last value to the first one of a small machine

_FILE_ERRORS = {
    409: "the file was changed since it was read",
    422: "there is no file, or it can't be read, or the page is switched off",
    503: "the main process does not answer",
}
ADDRESSES = ApiAddresses("/api/setup", least=Level.TECHNICIAN, errors=_FILE_ERRORS)


@ADDRESSES.get("/settings", "settings", "the configuration's file, and what may be set")
async def _settings(services: WebServices, caller: RequestCaller) -> SettingsView:
    found = await services.client.ask(ReadSettings(), SettingsDocument, caller.writer)
    return SettingsView.model_validate({**structs.asdict(found), "restart_s": RESTART_S})


@ADDRESSES.post(
    "/password",
    "new_password",
    "hash a user's new password for the next save",
    body_bytes=LOGIN_BYTES,
    audited=False,
    errors={
        400: "the password is too weak, or the body is not what is described here",
        409: "",
        422: "",
        429: "too many passwords in a short time",
        503: "too many logins are being checked",
    },
)
async def _password(
    request: Request, services: WebServices, caller: RequestCaller, body: NewPasswordBody
) -> NewPasswordView:
    logins: Logins = request.app.state.logins
    kept = await services.new_passwords.keep(caller, body.name, body.password, logins.passwords)
    return NewPasswordView(password_hash=kept)


@ADDRESSES.post(
    "/first-password",
    "first_password",
    "make the first technician, while there is no user",
    least=Level.OPEN,
    body_bytes=LOGIN_BYTES,
    errors={
        400: "the password is too weak, or the body is not what is described here",
        409: "somebody else has made it",
        429: "too many passwords in a short time",
    },
)
async def _first_password(
    request: Request, services: WebServices, caller: RequestCaller, body: NewPasswordBody
) -> FirstPasswordView:
    logins: Logins = request.app.state.logins
    if not logins.config.awaits_first_user:
        raise RefusalError(409, "made", "the first password was made already: log in")
    made = await services.new_passwords.hashed(caller, body.name, body.password, logins.passwords)
    await services.client.ask(MakeFirstUser(body.name, made), SettingsSaved, caller.writer)
    logins.record(AuditRecord(AuditKind.CHANGED, body.name, caller.address, "the first password, as technician"))
    return FirstPasswordView(name=body.name)


@ADDRESSES.post(
    "/preview", "preview_settings", "what changes of the file would do", body_bytes=BODY_BYTES, audited=False
)
async def _preview(services: WebServices, caller: RequestCaller, body: ChangesBody) -> PreviewView:
    wanted = PreviewSettings(_changes(services, caller, body), body.digest, body.undo)
    found = await services.client.ask(wanted, SettingsPreview, caller.writer)
    return PreviewView.model_validate(found)


@ADDRESSES.post(
    "/save",
    "save_settings",
    "write changes into the configuration's file",
    body_bytes=BODY_BYTES,
    errors={409: f"the file was changed since it was read, or {warning_gate.REFUSED}"},
)
async def _save(services: WebServices, caller: RequestCaller, body: SaveChangesBody) -> SavedView:
    client, changes = services.client, _changes(services, caller, body)
    if not body.undo:  # going back asks nothing
        planned = await client.ask(PreviewSettings(changes, body.digest), SettingsPreview, caller.writer)
        await warning_gate.check(services.tuning, planned.vision, body.accepted, "are saved", caller.writer)
    saved = await client.ask(SaveSettings(changes, body.digest, body.undo), SettingsSaved, caller.writer)
    return SavedView.model_validate(saved)


@ADDRESSES.post("/restart", "restart", "end the gateway cleanly and start it again", body_bytes=BODY_BYTES)
async def _restart(services: WebServices, caller: RequestCaller, body: RestartBody) -> RestartView:
    if not body.confirmed:
        raise RefusalError(409, "confirm", f"stop is shown on all bays for about {RESTART_S:g} s: confirm it")
    client = services.client
    if client.about.source:
        found = await client.ask(ReadSettings(), SettingsDocument, caller.writer)
        if found.faults:
            first = found.faults[0]
            raise ConfigError(f"it would not start: {'.'.join(first.path)}: {first.message}")
    try:
        await client.command(RestartGateway(body.despite_trucks, caller.session), caller.writer)
    except RefusedError as error:
        if str(error).startswith(TRUCK_AT_BAY):
            raise RefusalError(409, "truck", str(error)) from None
        raise
    return RestartView(seconds=RESTART_S, boot=client.about.boot)


@ADDRESSES.get("/boot", "boot", "which start of the gateway answers")
async def _boot(services: WebServices) -> BootView:
    return BootView(boot=services.client.about.boot)


def _changes(services: Services, caller: Caller, body: ChangesBody) -> tuple[SettingChange, ...]:
    """Raises RefusalError (409) for a new password that is not known (any more)."""
    listed = (SettingChange(tuple(change.path), change.value) for change in body.changes)
    return tuple(services.new_passwords.filled_in(caller, change) for change in listed)
