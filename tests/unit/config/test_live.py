"""What differs between two configurations, and what of it a running gateway takes over."""

import tomllib

import pytest

from gateway.config import GatewayConfig, parse
from gateway.config.live import HIDDEN, LIVE, changes, in_force

HASH = "$argon2id$v=19$m=65536,t=3,p=4$c2FsdHNhbHRzYWx0$" + "{}" * 43
ANNA = f'[[hmi.users]]\nname = "anna"\nrole = "technician"\npassword_hash = "{HASH.format(*"a" * 43)}"\n'
TWO_BAYS = '[[bays]]\nname = "A"\n[[bays]]\nname = "B"\nunit_id = 2\n'


def settings(text: str) -> GatewayConfig:
    return parse(tomllib.loads(text), text=text)


def found(old: str, new: str) -> list[tuple[str, object, object, bool]]:
    """The dotted path, the values and live, of each change."""
    return [(".".join(c.path), c.old, c.new, c.live) for c in changes(settings(old), settings(new))]


def test_equal_configurations_do_not_differ_however_they_are_written() -> None:
    assert found('site = "site1"\n[vision]\ncoast_s = 0.3', "") == []
    assert found(TWO_BAYS, '[[bays]]\nname = "B"\nunit_id = 2\n[[bays]]\nname = "A"\n') == []  # the order has no effect


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('log_level = "debug"', ("log_level", "info", "debug", True)),
        ('log_format = "json"', ("log_format", "text", "json", False)),
        ('[vision]\nmethod = "paper"', ("bays.bay1.vision.method", "robust", "paper", True)),
        ("[vision]\nworkers = 2", ("bays.bay1.vision.workers", 1, 2, False)),
        ("[fusion]\nradius_threshold_px = 150.0", ("bays.bay1.fusion.radius_threshold_px", 180.0, 150.0, False)),
        ('[ranger]\nport = "/dev/ttyUSB0"', ("bays.bay1.ranger.port", "/dev/ttyACM0", "/dev/ttyUSB0", False)),
        ("[camera.controls]\ngain = 5", ("bays.bay1.camera.controls.gain", None, 5, True)),
        ("[camera]\nrotation_deg = 90", ("bays.bay1.camera.rotation_deg", 0, 90, False)),
        ("[camera.picture]\nclipped_max = 0.5", ("bays.bay1.camera.picture.clipped_max", 0.6, 0.5, False)),
        ("[modbus.handshake]\ntrigger_timeout_s = 2.0", ("modbus.handshake.trigger_timeout_s", 1.0, 2.0, False)),
        ("[hmi]\nmax_viewers = 8", ("hmi.max_viewers", 64, 8, True)),
        ("[hmi]\nport = 8081", ("hmi.port", 8080, 8081, False)),
        ("[records]\nmax_days = 30", ("records.max_days", 90, 30, True)),
        ("[records]\nenabled = false", ("records.enabled", True, False, False)),
    ],
)
def test_a_key_that_differs_and_whether_it_is_live(text: str, expected: tuple[str, object, object, bool]) -> None:
    assert found("", text) == [expected]
    path, old, new, live = expected
    assert found(text, "") == [(path, new, old, live)]


def test_a_table_that_is_added_is_listed_by_its_keys() -> None:
    lens = "[vision.intrinsics]\nfx = 900.0\nfy = 900.0\ncx = 640.0\ncy = 360.0\n"
    assert found("", lens) == [
        (f"bays.bay1.vision.intrinsics.{key}", None, value, True)
        for key, value in (("fx", 900.0), ("fy", 900.0), ("cx", 640.0), ("cy", 360.0))
    ]
    tls = '[mqtt]\nurl = "mqtts://broker"\n'
    assert found(tls, f"{tls}[mqtt.tls]\n") == [("mqtt.tls", None, {}, False)]


def test_a_bay_that_is_added_or_removed_needs_a_restart() -> None:
    added = found('[[bays]]\nname = "A"\n', f'{TWO_BAYS}vision.method = "paper"\n')
    assert added == [
        ("bays.B.name", None, "B", False),
        ("bays.B.unit_id", None, 2, False),
        ("bays.B.vision.method", None, "paper", False),
    ]


def test_passwords_are_not_shown_but_their_change_is() -> None:
    other = ANNA.replace("a" * 43, "b" * 43)
    assert found(ANNA, other) == [("hmi.users.anna.password_hash", HIDDEN, HIDDEN, True)]
    assert found("", ANNA)[-1] == ("hmi.users.anna.password_hash", None, HIDDEN, True)
    old, new = (f'[mqtt]\nurl = "mqtt://user:{word}@broker"' for word in ("geheim", "secret"))
    assert found(old, new) == [("mqtt.url", "mqtt://***@broker", "mqtt://***@broker", False)]
    assert found("[sinks.other]\nip = 1", '[sinks.other]\nip = 1\ntoken = "x"') == [
        ("sinks.other.token", None, HIDDEN, False)
    ]


def test_a_part_with_a_key_that_needs_a_restart_waits_as_a_whole() -> None:
    both = "[vision]\ncoast_s = 0.5\n[fusion]\nradius_threshold_px = 150.0\n"
    assert [live for *_, live in found("", both)] == [False, False]
    one = f"{TWO_BAYS}vision.coast_s = 0.5\n"
    other = one.replace("[[bays]]", "[[bays]]\nfusion.radius_threshold_px = 150.0", 1)
    assert [live for *_, live in found(TWO_BAYS, one)] == [True]
    assert found(TWO_BAYS, other) == [  # of A, and of B
        ("bays.A.fusion.radius_threshold_px", 180.0, 150.0, False),
        ("bays.B.vision.coast_s", 0.3, 0.5, True),
    ]
    # Logins that are made for the loopback address alone.
    open_to_all = '[hmi]\nhost = "10.0.0.1"'
    assert found(open_to_all, '[hmi]\nwithout_login = "technician"') == [
        ("hmi.host", "10.0.0.1", "127.0.0.1", False),
        ("hmi.without_login", "driver", "technician", False),
    ]
    recipe = '[[recipes]]\nid = 3\nname = "small"\nfusion.radius_threshold_px = 90.0\n'
    assert not any(live for *_, live in found("", f"{recipe}[vision]\ncoast_s = 0.5"))


def test_in_force_is_the_old_configuration_with_what_is_live_of_the_new() -> None:
    old = settings(TWO_BAYS)
    live = 'log_level = "error"\n[records]\nmax_mb = 50\n'
    new = settings(f"{live}[hmi]\nmax_viewers = 8\nport = 1\n{TWO_BAYS}vision.coast_s = 0.5\n")

    held = in_force(old, new)

    assert held == settings(f"{live}{TWO_BAYS}vision.coast_s = 0.5\n")
    assert [".".join(c.path) for c in changes(held, new)] == ["hmi.port", "hmi.max_viewers"]  # what a restart is for
    assert in_force(old, settings('[[bays]]\nname = "C"\nvision.coast_s = 0.5\n')) == old


def test_every_row_of_the_table_names_keys_that_exist() -> None:
    default = settings("")
    for row in LIVE:
        section = default.bays[0].vision if row.path[0] == "bays" else getattr(default, row.path[0])
        assert all(key in type(section).model_fields for key in row.but)
