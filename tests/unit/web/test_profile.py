"""A saved setting: the file then says exactly that, and every line that is not concerned is what it was."""

import difflib
import tomllib
from pathlib import Path
from typing import Any

import pytest

from gateway.config import VisionConfig, parse
from gateway.errors import ConfigError
from gateway.web.profile import parameter_schema, profile, settings_edit
from gateway.web.profile.redact import redacted
from gateway.web.profile.toml_edit import with_keys

SHARED = """\
# One bay.
site = "plant1"            # in topics

[vision]  # the marker
method = "robust"          # or "paper"
red_low_1 = [
  0, 43,   # hue, saturation
  46,
]

# ---- the ranger
[ranger]
port = "x"
"""
FOUR = """\
[mqtt]
url = "mqtt://gateway:secret@broker.plant:1883"

[vision]
min_confidence = 0.6       # much red about

[[bays]]
name = "bay1"
unit_id = 1
camera.url = "0"

[[bays]]
name = "bay2"
unit_id = 2
vision.min_confidence = 0.7   # more still
camera.url = "1"

# the third bay
[[bays]]
name = "bay3"
unit_id = 3

[bays.vision]
# by the paper
method = "paper"

[bays.camera]
url = "2"

[[bays]]
name = "bay4"
unit_id = 4
vision = { method = "paper" }  # short
"""


def proposed(text: str, bay: str = "bay1", **changes: Any) -> profile.Proposal:
    wanted = parameter_schema.validated(changes, profile.in_file(text, bay, source="plant.toml"))
    return profile.propose(text, bay, wanted, source="plant.toml")


def added(found: profile.Proposal) -> list[str]:
    return [
        line[2:]
        for line in difflib.ndiff(found.former.splitlines(), found.text.splitlines())
        if line.startswith(("+ ", "- "))
    ]


ALONE = '[vision]\nmethod = "robust"  # both\n\n[[bays]]\nname = "bay1"\nvision.coast_s = 0.2\n'
BELOW = (
    '[[bays]]\nname = "a"\n[bays.vision.intrinsics]\nfx = 600.0\nfy = 600.0\ncx = 320.0\ncy = 240.0\n'
    '\n[[bays]]\nname = "b"\nunit_id = 2\n'
)


@pytest.mark.parametrize(
    ("text", "bay", "changes", "lines"),
    [
        pytest.param(SHARED, "bay1", {"method": "paper"}, [
            'method = "robust"          # or "paper"', 'method = "paper"          # or "paper"'], id="value"),
        pytest.param(SHARED, "bay1", {}, [], id="nothing"),
        pytest.param(FOUR, "bay1", {"min_confidence": 0.55}, ["vision.min_confidence = 0.55"], id="one of several"),
        pytest.param(FOUR, "bay2", {"coast_s": 0.1}, ["vision.coast_s = 0.1"], id="dotted"),
        pytest.param(FOUR, "bay3", {"coast_s": 0.1}, ["coast_s = 0.1"], id="table of its own"),
        pytest.param(FOUR, "bay2", {"min_confidence": 0.75}, [
            "vision.min_confidence = 0.7   # more still", "vision.min_confidence = 0.75   # more still"], id="own key"),
        pytest.param(FOUR, "bay4", {"coast_s": 0.1}, [
            'vision = { method = "paper" }  # short',
            'vision = { method = "paper", coast_s = 0.1}  # short'], id="inline"),
        pytest.param(ALONE, "bay1", {"method": "paper", "coast_s": 0.25, "min_fill": 0.5}, [
            'method = "robust"  # both', 'method = "paper"  # both', "min_fill = 0.5",
            "vision.coast_s = 0.2", "vision.coast_s = 0.25"], id="shared and own"),
        pytest.param(BELOW, "a", {"method": "paper"}, ['vision.method = "paper"'], id="only a table below"),
    ],
)  # fmt: skip
def test_only_the_lines_of_the_change_differ(text: str, bay: str, changes: dict[str, Any], lines: list[str]) -> None:
    found = proposed(text, bay, **changes)
    assert added(found) == lines
    assert dict(found.changes) == changes
    if not lines:
        assert (found.text, found.diff) == (text, "")


COLOURED = '[vision]\nmarker_colour = "#e75b12"  # orange\n'


def test_a_colour_that_is_not_needed_any_more_is_removed_and_is_in_no_profile() -> None:
    assert added(proposed(COLOURED, "bay1", marker_colour=None)) == ['marker_colour = "#e75b12"  # orange']
    own = FOUR.replace("vision.min_confidence = 0.7 ", 'vision.marker_colour = "#1e3cb4"\nvision.min_confidence = 0.7 ')
    assert added(proposed(own, "bay2", marker_colour=None)) == ['vision.marker_colour = "#1e3cb4"']
    assert "marker_colour" not in profile.export("bay1", VisionConfig(), site="s", wall_ns=0)
    orange = profile.export("bay1", VisionConfig(marker_colour="#e75b12"), site="s", wall_ns=0)
    assert profile.imported(orange, VisionConfig(), source="p").marker_colour == "#e75b12"


def test_a_shared_colour_is_not_removed_for_one_bay() -> None:
    with pytest.raises(ConfigError, match="change marker_colour by hand"):
        proposed(FOUR.replace("[vision]\n", COLOURED), "bay1", marker_colour=None)


def test_bays_in_one_line_are_changed_too() -> None:
    text = 'bays = [{name = "a"}, {name = "b", unit_id = 2, vision = {coast_s = 0.2}}]  # short\n'

    assert tomllib.loads(proposed(text, "a", method="paper").text)["bays"][0]["vision"] == {"method": "paper"}
    assert tomllib.loads(proposed(text, "b", method="paper").text)["bays"][1]["vision"] == {
        "coast_s": 0.2,
        "method": "paper",
    }


def test_the_diff_is_what_a_person_reads_and_shows_no_password() -> None:
    secret = '[mqtt]\nurl = "mqtt://gateway:s@cret@broker"\nold_password = "hush"\n[vision]\nmethod = "robust"\n'

    diff = profile.propose(
        secret.replace("old_password", "# old_password"), "bay1", VisionConfig(method="paper"), source="p"
    ).diff

    assert diff.splitlines() == [
        "--- p",
        "+++ p (new)",
        "@@ -2,4 +2,4 @@",
        ' url = "mqtt://***@broker"',
        " # old_password = ***",
        " [vision]",
        '-method = "robust"',
        '+method = "paper"',
    ]


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ('camera.url = "rtsp://me:pw@cam/1"', 'camera.url = "rtsp://***@cam/1"'),
        ('camera.url = "http://cam/v?token=abc&x=1"  # ours', 'camera.url = "http://cam/v?token=***&x=1"  # ours'),
        ("# http://cam/v?loginuse=me&loginpas=abc&x=1", "# http://cam/v?loginuse=me&loginpas=***&x=1"),
    ],
)
def test_a_camera_s_address_is_shown_without_what_opens_it(line: str, shown: str) -> None:
    diff = proposed(f"{line}\n[vision]\nmethod = 'robust'\n", method="paper").diff

    assert f" {shown}" in diff.splitlines()


HASH = f"$argon2id$v=19$m=19456,t=2,p=1${'c2FsdHNhbHRzYWx0c2FsdA'}${'aGFzaGhhc2hoYXNoaGFzaGhhc2hoYXNoaGFzaGhhc2g'}"
USER = f'name = "anna", role = "technician", password_hash = "{HASH}"'
SECRETS = ("c2Fsd", "aGFzaG", "19456", "s3cr", "hush")


@pytest.mark.parametrize(
    "above",
    [
        f"[hmi]\nusers = [{{ {USER} }}]\n",
        f"[hmi]\nusers = [\n  {{ {USER} }}, # the first\n]\n",
        f"hmi.users = [{{{USER}}}]\n",
        f"hmi = {{ users = [{{{USER}}}] }}\n",
        f"[hmi]\n[[hmi.users]]\nname = 'anna'\npassword_hash = '{HASH}'\n",
        f'[hmi]\n[[hmi.users]]\nname = "anna"\n"password_hash" = "{HASH}"\n',
        f'[hmi]\n[[hmi.users]]\nname = "anna"\npassword_hash = """\\\n  {HASH}"""\n',
        f"[hmi]\n[[hmi.users]]\nname = 'anna'\npassword_hash = \"{HASH.replace('c2Fs', chr(92) + 'u0063' + '2Fs')}\"\n",
        '[mqtt]\nurl = "mqtt://gateway:s3cr\\u0065t@broker"\n',
        "mqtt = { url = 'mqtt://gateway:s3cret@broker' }\n",
        "[mqtt]\n\"url\" = 'mqtt://gateway:s3@cret@broker'\n",
        '[camera]\nurl = """http://cam/v?x=1&token=s3cret"""\n',
        f"# users = [{{ name = 'anna', password_hash = '{HASH}' }}]\n",
        f"site = 'a' # {HASH}\n",
        "site = 'a' # the old password: hush\n# token=hush\n",
    ],
)
def test_whichever_way_a_password_is_written_the_diff_does_not_show_it(above: str) -> None:
    diff = proposed(f"{above}[vision]\nmethod = 'robust'\n", method="paper").diff

    assert [secret for secret in SECRETS if secret in diff] == []
    assert {"-method = 'robust'", '+method = "paper"'} <= set(diff.splitlines())


def test_a_line_that_holds_the_change_and_a_password_shows_the_change() -> None:
    text = f"bays = [{{camera = {{url = 'rtsp://me:s3cret@cam'}}}}]\nhmi = {{ users = [{{{USER}}}] }}\n"

    (new,) = (line for line in proposed(text, coast_s=0.125).diff.splitlines() if line.startswith("+bays"))

    assert "coast_s = 0.125" in new
    assert "rtsp://***@cam" in new
    assert "s3cr" not in new


def test_what_the_schema_does_not_know_is_not_shown() -> None:
    former = "[ranger]\ntemperature_c = 5.0\n"
    assert redacted(former, source="p") == former
    assert redacted('[hmi]\nnew_secret = "hush"\n[vision]\ncoast_s = 0.5 # short\n', source="p") == (
        '[hmi]\nnew_secret = "***"\n[vision]\ncoast_s = 0.5 # short\n'
    )


def test_every_value_of_every_section_is_shown_but_the_secret_ones() -> None:
    text = (Path(__file__).parents[3] / "config" / "four-bays.toml").read_text()
    assert redacted(text, source="p") == text


def test_a_file_that_is_wrong_already_is_not_touched() -> None:
    with pytest.raises(ConfigError, match=r"plant\.toml:1: vision\.metod .*unknown key"):
        proposed("vision.metod = 1\n")
    with pytest.raises(ConfigError, match=r"plant\.toml:\d+: .*not valid TOML"):
        proposed("[vision\n")
    with pytest.raises(ConfigError, match="no bay bay9; there is: bay1, bay2"):
        profile.in_file(FOUR, "bay9", source="p")


def test_an_export_can_be_imported_and_names_its_origin() -> None:
    tuned = VisionConfig(method="paper", red_low_1=(0, 90, 60), min_fill=0.75, coast_s=0.125)

    text = profile.export("bay2", tuned, site="plant1", wall_ns=1_795_300_000_000_000_000)

    assert text.startswith("# Vision profile of plant1, bay bay2, exported 2026-11-21 ")
    assert profile.imported(text, VisionConfig(workers=3), source="x") == tuned.model_copy(update={"workers": 3})
    assert parse(tomllib.loads(text)).bays[0].vision == tuned


def test_a_partial_profile_leaves_the_other_keys() -> None:
    base = VisionConfig(min_fill=0.5, coast_s=0.2)

    assert profile.imported("[vision]\ncoast_s = 1\n", base, source="x") == VisionConfig(min_fill=0.5, coast_s=1.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[vision]\nmin_fill = 2", r"red\.toml:2: vision\.min_fill = 2: .*allowed: >= 0, <= 1"),
        ("[vision]\nmin_fil = 0.5", r"red\.toml:2: vision\.min_fil .*unknown key"),
        ("[vision]\n\ngaussian_kernel_px = 4", r"red\.toml:3: vision\.gaussian_kernel_px = 4: must be odd"),
        ("[vision]\nred_low_1 = [20, 1, 1]", r"red\.toml:2: vision\.red_low_1 .*H = 20 lies above red_high_1's H = 10"),
        ("[vision]\nworkers = 2", r"red\.toml: vision\.workers: belongs to the machine"),
        ("[camera]\nurl = '0'\n[vision]\ncoast_s = 1", r"red\.toml: camera: a profile holds \[vision\] and nothing"),
        ("[vision]\n", r"red\.toml: there is no \[vision\] with keys"),
        ("vision = 3\n", r"red\.toml: there is no \[vision\] with keys"),
        ("[vision", r"red\.toml:1: not valid TOML"),
        ("#" * 70_000, r"red\.toml: more than 65536 characters"),
        (f"[vision]\na{'.a' * 5000} = 1", r"red\.toml:2: a line of 10005 characters; at most 400"),
    ],
)
def test_a_bad_profile_is_refused_with_file_key_value_and_range(text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        profile.imported(text, VisionConfig(), source="red.toml")


@pytest.mark.parametrize("litter", ["tracking = true\n", "min_fill = 0.5\n", "[fusion]\nlatch_stop = true\n"])
def test_an_editor_that_writes_anything_else_is_caught(monkeypatch: pytest.MonkeyPatch, litter: str) -> None:
    """Even a key with its own default: the file is to say what was shown, not more."""

    def littering(text: str, *rest: Any, **more: Any) -> str:
        return with_keys(text, *rest, **more) + litter

    monkeypatch.setattr(settings_edit, "with_keys", littering)
    text = '[vision]\nmethod = "robust"\n'
    proposed(text)

    with pytest.raises(ConfigError, match=r"cannot be changed by a program; change vision\.method by hand"):
        proposed(text, method="paper")
