"""The pages' languages: those shipped, and a plant's own over them."""

import json
import logging
import os
import tomllib
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.config import GatewayConfig, parse
from gateway.config_check import check
from gateway.errors import ConfigError
from gateway.web.languages import MAX_OWN, SHIPPED, languages, memory_of, of_memory, own, usable


def of_plant(folder: Path) -> GatewayConfig:
    toml = f'[hmi]\nenabled = true\nlanguages_folder = "{folder}"\n'
    return parse(tomllib.loads(toml), text=toml)


def own_files(folder: Path, *faults: str) -> dict[str, str]:
    """Those without a fault; and each fault is one of these."""
    found: list[ConfigError] = []
    texts = own(of_plant(folder), found.append)
    assert len(found) == len(faults)
    for each, fault in zip(found, faults, strict=True):
        assert str(each).startswith(str(folder))
        assert fault in str(each)
    return texts


def test_a_plants_words_stand_over_those_shipped_and_a_new_language_is_listed(tmp_path: Path) -> None:
    (tmp_path / "de.json").write_text(json.dumps({"name": "Werksdeutsch", "texts": {"driver|STOP": "STEH"}}))
    (tmp_path / "nl.json").write_text(json.dumps({"name": "Nederlands", "texts": {"driver|STOP": "STOP"}}))
    found = languages(own_files(tmp_path))
    assert found.catalogues["de"].texts["driver|STOP"] == "STEH"
    assert found.catalogues["de"].texts["driver|FORWARD"] == "VOR"
    listed = {row["code"]: row for row in found.listed()}
    assert (listed["nl"]["name"], listed["nl"]["pages"], listed["ar"]["direction"]) == ("Nederlands", False, "rtl")


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("de.json", "{", "is not JSON"),
        ("deutsch.json", "{}", "named by its code"),
        ("de.json", '{"texts": {}}', "name: Field required"),
        ("de.json", '{"name": "D", "texts": {"a": 1}}', "texts.a"),
        ("de.json", '{"name": "D", "direction": "up", "texts": {}}', "direction"),
        ("de.json", '{"name": "D", "texts": {"{n} of": "{m} von"}}', "nothing stands for {m}"),
        ("de.json", '{"name": "D", "texts": {"{n} faults": {"one": "{n} x"}}}', 'needs the form "other"'),
        ("de.json", '{"name": "D", "texts": {"a": "' + "b" * MAX_OWN + '"}}', "more than 2000000 characters"),
        ("de.json", "[" * 100_000, "is not JSON"),
    ],
)
def test_a_faulty_file_is_named_with_its_key(tmp_path: Path, name: str, text: str, fault: str) -> None:
    (tmp_path / name).write_text(text)
    assert own_files(tmp_path, fault) == {}


def test_a_plants_words_keep_the_direction_of_the_language_shipped(tmp_path: Path) -> None:
    def direction(**more: str) -> str:
        (tmp_path / "ar.json").write_text(json.dumps({"name": "العربية", "texts": {"driver|STOP": "توقف"}, **more}))
        return languages(own_files(tmp_path)).catalogues["ar"].direction

    assert direction() == "rtl"
    assert direction(direction="rtl") == "rtl"
    assert direction(direction="ltr") == "ltr"


def test_several_complete_languages_of_a_plant_reach_the_web_process(tmp_path: Path) -> None:
    for code, like in (("nl", "de"), ("pt", "es"), ("az", "tr")):
        (tmp_path / f"{code}.json").write_text((SHIPPED / f"{like}.json").read_text())
    texts = own_files(tmp_path)
    assert sorted(texts) == ["az", "nl", "pt"]
    memory = memory_of(texts)
    assert of_memory(memory) == texts
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(memory)
    assert of_memory(None) == {}
    assert languages(texts).catalogues["nl"].texts["Alarms"] == "Alarme"


def test_a_faulty_file_does_not_stop_the_gateway_which_does_without_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    good = json.dumps({"name": "Nederlands", "texts": {"driver|STOP": "STOP"}})
    for name, text in {"de.json": "{", "deutsch.json": "{}", "nl.json": good}.items():
        (tmp_path / name).write_text(text)
    config, toml = of_plant(tmp_path), f'[hmi]\nenabled = true\nlanguages_folder = "{tmp_path}"\n'
    check(config, source="g.toml", text=toml)
    with caplog.at_level(logging.ERROR):
        assert usable(config) == {"nl": good}
    assert [record.getMessage().partition(": ")[0] for record in caplog.records] == ["hmi.languages_folder"] * 2
    assert f"{tmp_path}/de.json: is not JSON" in caplog.text
    assert "deutsch.json: a language's file is named by its code" in caplog.text
    (tmp_path / "g.toml").write_text(toml)
    assert main(["check", str(tmp_path / "g.toml")]) == 2
    said = capsys.readouterr().err
    assert f"g.toml:3: hmi.languages_folder: {tmp_path}/de.json: is not JSON" in said
    assert "deutsch.json" in said


def test_a_folder_that_is_gone_does_not_stop_the_gateway(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert usable(of_plant(tmp_path / "gone")) == {}
    assert "is not a folder that can be read: No such file or directory; the pages do without it" in caplog.text
    assert usable(GatewayConfig()) == {}


def test_a_plants_files_are_bounded_and_no_pipe_is_waited_for(tmp_path: Path) -> None:
    text = json.dumps({"name": "Deutsch", "texts": {"Alarms": "A" * 1_100_000}})
    (tmp_path / "de.json").write_text(text)
    assert own_files(tmp_path) == {"de": text}
    (tmp_path / "nl.json").write_text(text)
    assert own_files(tmp_path, "have more than 2000000 characters together") == {"de": text}
    (tmp_path / "nl.json").unlink()
    os.mkfifo(tmp_path / "nl.json")
    assert own_files(tmp_path, "nl.json: is not a file") == {"de": text}
