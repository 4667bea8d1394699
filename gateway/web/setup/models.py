"""What the settings page requests, and what it is answered. Pure."""

import json
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from gateway.config.strict import forms
from gateway.web.auth.passwords import MAX_LENGTH
from gateway.web.profile.settings_edit import MAX_CHANGES, MAX_DEPTH
from gateway.web.tuning.request_models import Accepted, Body

KeyPath = Annotated[
    list[Annotated[str, Field(min_length=1, max_length=200)]], Field(min_length=1, max_length=MAX_DEPTH)
]


Parsed = BeforeValidator(json.loads)


class AnswerModel(Body):
    """Its fields are read from the record that it shows."""

    model_config = ConfigDict(strict=False, from_attributes=True)


class SettingChangeBody(Body):
    """One change of the file."""

    path: KeyPath = Field(
        description='of a key or table, such as ["bays", "A", "camera", "url"]; bays and users by their name, recipes '
        "by their id"
    )
    value: Any = Field(None, description="null: removed, so that the default holds, or what is set for every bay")


class NewPasswordBody(Body):
    """A password for a user who is there, or is about to be made."""

    name: str = Field(pattern=forms.USER_NAME, description="of the user, as in hmi.users")
    password: str = Field(max_length=MAX_LENGTH, repr=False)


class NewPasswordView(AnswerModel):
    """What stands for the hash, which is not shown."""

    password_hash: str = Field(
        description="the value for hmi.users.<name>.password_hash in a preview or save: for an hour, this login and "
        "this user"
    )


class FirstPasswordView(AnswerModel):
    """There is a technician."""

    name: str = Field(description="who may log in as soon as /api/session says so")


class ChangesBody(Body):
    """Changes of the file of this digest."""

    digest: str = Field(pattern=r"^[0-9a-f]{64}$", description="of the file as it was read")
    changes: list[SettingChangeBody] = Field([], max_length=MAX_CHANGES)
    undo: bool = Field(False, description="in place of changes: the file as it was before the last save")


class SaveChangesBody(ChangesBody):
    """The changes go into the file."""

    accepted: Accepted = Field([])


class RestartBody(Body):
    """Ends the gateway and starts it again."""

    confirmed: bool = Field(False, description="stop is shown on all bays until it has started again")
    despite_trucks: bool = Field(False, description="also while a truck is at a bay")


class FaultView(AnswerModel):
    """Why the file can't be as it is requested."""

    path: list[str] = Field(description="of the key; empty: the whole file")
    line: int | None = Field(description="of the file, from 1; null: it is not in the file")
    message: str


class SettingsView(AnswerModel):
    """The configuration's file. Passwords are `***`."""

    values: Annotated[dict[str, Any] | None, Parsed] = Field(
        description="every key with its value, defaults included; lists of tables are objects by name; null: the file "
        "has faults"
    )
    written: Annotated[dict[str, Any], Parsed] = Field(description="what the file itself sets")
    json_schema: Annotated[dict[str, Any], Parsed] = Field(
        validation_alias="schema", description="JSON Schema of the file: meaning, range, default, unit"
    )
    digest: str
    file: str = Field(validation_alias="path")
    why_not: str = Field(description="why nothing can be saved; empty: no known reason")
    command_line: list[list[str]] = Field(description="paths of keys that the command line sets")
    faults: list[FaultView]
    waiting: list[str] = Field(description="what the file says and only a restart puts into force")
    undo: bool = Field(description="the last save can be undone")
    restart_s: float = Field(description="about how long all bays show stop at a restart")


class PreviewView(AnswerModel):
    """What a save would do."""

    diff: str = Field(description="unified; passwords masked")
    faults: list[FaultView] = Field(description="with any of them nothing can be saved")
    warnings: list[str] = Field(description="legal, and no good idea")
    live: list[str] = Field(description="takes effect at the save")
    restart: list[str] = Field(description="takes effect at the next start")
    digest: str
    why_not: str


class SavedView(AnswerModel):
    """What was saved."""

    live: list[str]
    restart: list[str]
    digest: str = Field(description="of the file as it is now")
    previous: str = Field(description="path of the former file")


class RestartView(AnswerModel):
    """The gateway is about to end."""

    seconds: float = Field(description="about how long all bays show stop")
    boot: str = Field(description="of the start that ends now; GET /api/setup/boot has another one afterwards")


class BootView(AnswerModel):
    """Which start of the gateway answers."""

    boot: str


class FindingView(AnswerModel):
    """One line of an examination."""

    part: str = Field(description="what kind of thing")
    name: str = Field(description="which one; empty where there is one")
    verdict: Literal["ok", "warning", "fault"]
    tried: str
    result: str
    remedy: str = Field(description="what to do; empty: nothing")


class DoctorView(AnswerModel):
    """What `gateway doctor` finds beside the running gateway."""

    findings: list[FindingView]
    complete: bool = Field(description="false: a part took too long, and what follows it was not tried")
