"""A configuration's text as people may see it: without passwords, whichever way TOML has of writing them. Pure.

The sections define what is a password, as for `gateway check --full`: a field without `repr` is one, any address may
hold one. The text is read, not searched: quoted keys, tables in one line and escapes make no difference.
"""

import re
import tomllib
from collections.abc import Mapping, MutableMapping, MutableSequence
from typing import Any

import tomlkit
from pydantic.fields import FieldInfo
from tomlkit.exceptions import TOMLKitError

from gateway.config import BayConfig, GatewayConfig, RangerConfig
from gateway.config.sections.ranger import Hcsr04Config
from gateway.config.strict.errors import PASSWORD_KEY, without_password
from gateway.config.strict.section import inner_model
from gateway.errors import ConfigError

HIDDEN = "***"
Fields = Mapping[str, FieldInfo]
_FIELDS: Fields = {**BayConfig.model_fields, **GatewayConfig.model_fields}  # the shared sections are at the top
# In a comment nothing has a name of the sections.
_REMARK = re.compile(r"(?i)(#.*?(?:pass|pwd|secret|token|hash)[^=:]*[=:]).*$")
_LOGIN = re.compile(r"://[^\s]*@")
_IN_ADDRESS = re.compile(rf"{PASSWORD_KEY}[^&#\"'\s]*")
_HASH = re.compile(r"\$argon2[^\s\"']*")


def redacted(text: str, *, source: str, fields: Fields = _FIELDS) -> str:
    """`text` is one that the gateway reads, `fields` its keys. Raises ConfigError where the result can't be
    verified."""
    try:
        document = tomlkit.parse(text)
        _hide(document, fields)
        shown = tomlkit.dumps(document)
        same = tomllib.loads(shown) == plainly(tomllib.loads(text), fields)
    except (TOMLKitError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise ConfigError(f"{source}: can't be shown without its passwords") from error
    if not same:
        raise ConfigError(f"{source}: can't be shown without its passwords")
    return "\n".join(map(_remark, shown.split("\n")))


def _hide(table: MutableMapping[str, Any], fields: Fields) -> None:
    """In place; comments and layout stay."""
    for key in list(table):
        value, info = table[key], fields.get(key)
        if info is None or not info.repr:
            table[key] = HIDDEN
        elif isinstance(value, MutableMapping):
            _hide(value, _inside(info))
        elif isinstance(value, MutableSequence):
            for n, item in enumerate(value):
                if isinstance(item, MutableMapping):
                    _hide(item, _inside(info))
                elif isinstance(item, str) and (shown := without_password(item)) != item:
                    value[n] = shown
        elif isinstance(value, str) and (shown := without_password(value)) != value:
            table[key] = shown


def plainly(value: Mapping[str, Any], fields: Fields) -> dict[str, Any]:
    """The same of the values only: what the shown text must contain."""

    def shown(one: Any, info: FieldInfo) -> Any:
        match one:
            case dict():
                return plainly(one, _inside(info))
            case list():
                return [shown(item, info) for item in one]
            case str():
                return without_password(one)
        return one

    return {
        key: shown(one, fields[key]) if key in fields and fields[key].repr else HIDDEN for key, one in value.items()
    }


def _inside(info: FieldInfo) -> Fields:
    model = inner_model(info.annotation)
    former = (
        Hcsr04Config.model_fields if model is not None and issubclass(model, RangerConfig) else {}
    )  # where they stood in 0.1.0
    return {} if model is None else {**model.model_fields, **former}


def _remark(line: str) -> str:
    return _HASH.sub(
        HIDDEN, _REMARK.sub(rf"\1 {HIDDEN}", _IN_ADDRESS.sub(rf"\1{HIDDEN}", _LOGIN.sub(f"://{HIDDEN}@", line)))
    )
