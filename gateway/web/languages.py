"""The pages' texts by language: one JSON file a language, those shipped and a plant's own (`hmi.languages_folder`). IO.

    {"name": "Deutsch", "direction": "ltr", "texts": {"Alarms": "Alarme", "driver|STOP": "HALT",
     "{0} faults": {"one": "{0} Störung", "other": "{0} Störungen"}}}

A text's key is the English text itself, with what it is about before a bar where one English word has several
meanings. What a file does not have is shown in English.
"""

import json
import logging
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gateway.config import GatewayConfig
from gateway.errors import ConfigError

log = logging.getLogger(__name__)

SHIPPED = Path(str(files("gateway.web") / "static" / "languages"))
CODE = re.compile(r"[a-z]{2,3}")
MAX_OWN = 2_000_000  # characters of a plant's own files together; a language with every text has about 200,000
_PLACEHOLDER = re.compile(r"\{(\w+)\}")
Forms = dict[Literal["zero", "one", "two", "few", "many", "other"], str]  # plural categories of CLDR


class Catalogue(BaseModel):
    """One language's file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: str = Field(min_length=1, max_length=40, description="the language's own name, for the list")
    direction: Literal["ltr", "rtl"] = "ltr"
    texts: dict[str, str | Forms]

    @property
    def pages(self) -> bool:
        """Has it texts of other pages than the driver's display?"""
        return any("|" not in key for key in self.texts)


@dataclass(frozen=True, slots=True)
class Languages:
    """`catalogues`: by code, in the order of the codes; a plant's texts over those shipped."""

    catalogues: dict[str, Catalogue]

    def listed(self) -> list[dict[str, Any]]:
        return [
            {"code": code, "name": one.name, "direction": one.direction, "pages": one.pages}
            for code, one in self.catalogues.items()
        ]


def usable(config: GatewayConfig) -> dict[str, str]:
    """A plant's own files, by code, without those that are faulty: the log names them. No word is worth a bay."""
    return own(config, lambda error: log.error("hmi.languages_folder: %s; the pages do without it", error))


def own(config: GatewayConfig, report: Callable[[ConfigError], None]) -> dict[str, str]:
    """A plant's own files, for `languages`: their texts, by code. `report` is told what is wrong with a file, which is
    then left out.
    """
    found: dict[str, str] = {}
    folder = config.hmi.languages_folder
    try:
        paths = [] if folder is None else _files(Path(folder))
    except ConfigError as error:
        report(error)
        return found
    for path in paths:
        try:
            found[path.stem] = _file(path, MAX_OWN - sum(map(len, found.values())))
        except ConfigError as error:
            report(error)
    return found


def _files(folder: Path) -> list[Path]:
    """Raises ConfigError."""
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix == ".json")
    except OSError as error:
        raise ConfigError(f"{folder}: is not a folder that can be read: {error.strerror}") from None
    return found


def _file(path: Path, most: int) -> str:
    """Its text. Raises ConfigError."""
    if not CODE.fullmatch(path.stem):
        raise ConfigError(f"{path}: a language's file is named by its code, as de.json: two or three small letters")
    if not path.is_file():  # a pipe would be waited for
        raise ConfigError(f"{path}: is not a file")
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(most + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from None
    if len(text) > most:
        raise ConfigError(f"{path}: the files *.json of this folder have more than {MAX_OWN} characters together")
    _catalogue(text, str(path))
    return text


def memory_of(texts: Mapping[str, str]) -> int:
    """A plant's own texts as anonymous memory, to be inherited by the web process and to be closed: too much for a
    message, and its folder is not the web process's to read. Returns the descriptor.
    """
    memory = os.memfd_create("gateway-languages", os.MFD_CLOEXEC)
    with open(memory, "wb", closefd=False) as file:
        file.write(json.dumps(dict(texts)).encode())
    os.lseek(memory, 0, os.SEEK_SET)
    return memory


def of_memory(memory: int | None) -> dict[str, str]:
    """What `memory_of` was given; None: nothing. Closes it."""
    if memory is None:
        return {}
    with open(memory, "rb") as file:
        texts: dict[str, str] = json.load(file)
    return texts


def languages(texts: Mapping[str, str]) -> Languages:
    """Those shipped, with a plant's own texts over them."""
    found = {path.stem: _catalogue(path.read_text(encoding="utf-8"), path.name) for path in SHIPPED.glob("*.json")}
    for code, text in texts.items():
        changed = _catalogue(text, code)
        shipped = found.get(code)
        if shipped is not None:
            kept = {} if "direction" in changed.model_fields_set else {"direction": shipped.direction}
            changed = changed.model_copy(update={"texts": {**shipped.texts, **changed.texts}, **kept})
        found[code] = changed
    return Languages(dict(sorted(found.items())))


def _catalogue(text: str, name: str) -> Catalogue:
    try:
        made = Catalogue.model_validate(json.loads(text))
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"{name}: {'.'.join(map(str, fault['loc']))}: {fault['msg']}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}: is not JSON: {error}") from None
    for key, value in made.texts.items():
        for form in [value] if isinstance(value, str) else value.values():
            if foreign := set(_PLACEHOLDER.findall(form)) - set(_PLACEHOLDER.findall(key)):
                raise ConfigError(f"{name}: texts.{key}: nothing stands for {{{min(foreign)}}}; the key names what can")
        if not isinstance(value, str) and "other" not in value:
            raise ConfigError(f'{name}: texts.{key}: needs the form "other"')
    return made
