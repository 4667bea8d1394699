"""A configuration of before, as a later version wants it."""

import tomllib
from pathlib import Path

import pytest

from gateway import config
from gateway.cli.main import main
from gateway.errors import ConfigError
from gateway.update import migrations
from gateway.update.migrations import KEY_CHANGES, KeyChange, migrated

TEXT = """\
# the plant's own words
site = "plant"  # north

[fusion]
threshold_px = 190.0  # measured in March
# the next one was tried
gone = true

[[bays]]
name = "a"
[bays.fusion]
threshold_px = 200.0
[bays.camera]
gone = "other"

[[bays]]
name = "b"
fusion.threshold_px = 210.0
"""
CHANGES = (
    KeyChange("0.3.0", ("fusion",), "threshold_px", "radius_threshold_px", "one word, one meaning"),
    KeyChange("0.4.0", ("fusion",), "gone", "", "it had no effect"),
    KeyChange("0.4.0", (), "site", "plant", "as in MQTT"),
)


def test_keys_are_renamed_and_removed_where_they_are_with_their_comments() -> None:
    text, done = migrated(TEXT, source="x.toml", changes=CHANGES)
    assert text.splitlines()[:6] == [
        "# the plant's own words",
        'plant = "plant"  # north',
        "",
        "[fusion]",
        "radius_threshold_px = 190.0  # measured in March",
        "# the next one was tried",
    ]
    data = tomllib.loads(text)
    assert data["fusion"] == {"radius_threshold_px": 190.0}
    assert data["bays"][0] == {"name": "a", "fusion": {"radius_threshold_px": 200.0}, "camera": {"gone": "other"}}
    assert data["bays"][1] == {"name": "b", "fusion": {"radius_threshold_px": 210.0}}
    assert done == [
        "fusion.threshold_px: is radius_threshold_px now (0.3.0: one word, one meaning)",
        "bays[0].fusion.threshold_px: is radius_threshold_px now (0.3.0: one word, one meaning)",
        "bays[1].fusion.threshold_px: is radius_threshold_px now (0.3.0: one word, one meaning)",
        "fusion.gone: removed (0.4.0: it had no effect)",
        "site: is plant now (0.4.0: as in MQTT)",
    ]
    assert migrated(text, source="x.toml", changes=CHANGES) == (text, []), "a second time there is nothing to do"


def test_both_names_at_once_are_an_error_that_names_them() -> None:
    text = "[fusion]\nthreshold_px = 1\nradius_threshold_px = 2\n"
    with pytest.raises(ConfigError, match=r"x: fusion\.threshold_px is fusion\.radius_threshold_px since 0\.3\.0"):
        migrated(text, source="x", changes=CHANGES)


def test_a_table_in_several_pieces_is_left_to_people() -> None:
    text = "[fusion]\nthreshold_px = 1\n[modbus]\nport = 5\n[fusion.x]\ny = 1\n"
    with pytest.raises(ConfigError, match=r"x: fusion\.threshold_px is .* since 0\.3\.0: change it by hand"):
        migrated(text, source="x", changes=CHANGES)


@pytest.mark.parametrize("name", ["gateway.toml", "four-bays.toml"])
def test_the_shipped_configurations_are_as_this_version_wants_them(name: str) -> None:
    text = (Path(__file__).parents[3] / "config" / name).read_text()
    assert migrated(text, source=name) == (text, [])


def test_every_new_name_is_a_key_that_there_is() -> None:
    for change in KEY_CHANGES:
        document = migrated(f"[{'.'.join(change.section)}]\n", source="", changes=())[0]
        assert config.parse(tomllib.loads(document)) is not None


def test_the_verb_writes_a_copy_only_where_something_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = tmp_path / "old.toml", tmp_path / "new.toml"
    old.write_text(TEXT)
    assert main(["update", "--migrate", str(old), str(new)]) == 0
    assert capsys.readouterr().out == "no key has another name in this version\n"
    assert not new.exists()
    monkeypatch.setattr(migrations.migrated, "__kwdefaults__", {"changes": CHANGES})
    assert main(["update", "--migrate", str(old), str(new)]) == 0
    assert "site: is plant now" in capsys.readouterr().out
    assert tomllib.loads(new.read_text())["plant"] == "plant"
    assert old.read_text() == TEXT
