"""What identifies a configuration."""

import tomllib

import pytest

from gateway.config import parse
from gateway.config.digest import digest

HASH = "$argon2id$v=19$m=65536,t=3,p=4$c2FsdHNhbHRzYWx0$" + "{}" * 43
PLAIN = (
    'site = "north"\n[mqtt]\nurl = "mqtt://gw:one@broker"\n'
    '[sinks.postgresql]\nurl = "postgresql://db/gw"\npassword = "one"\n'
    '[[hmi.users]]\nname = "anna"\nrole = "technician"\npassword_hash = "' + HASH.format(*"a" * 43) + '"\n'
    '[[bays]]\nname = "A"\n[[bays]]\nname = "B"\nunit_id = 2\n'
)


def of(text: str) -> str:
    return digest(parse(tomllib.loads(text), text=text))


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ('site = "north"', '# reviewed on Monday\nlog_level = "info"\nsite   =  "north"'),
        ("gw:one@", "gw:another@"),
        ('password = "one"', 'password = "another"'),
        ("a" * 43, "b" * 43),
        ('name = "A"\n[[bays]]\nname = "B"\nunit_id = 2', 'name = "B"\nunit_id = 2\n[[bays]]\nname = "A"'),
        ('name = "A"\n', 'name = "A"\n[bays.fusion]\ndistance_threshold_mm = 300\n'),
    ],
)
def test_layout_defaults_order_of_bays_and_passwords_do_not_count(was: str, now: str) -> None:
    assert was in PLAIN
    assert of(PLAIN.replace(was, now)) == of(PLAIN)


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ('site = "north"', 'site = "south"'),
        ("gw:one@broker", "gw:one@other"),
        ("postgresql://db", "postgresql://db2"),
        ('role = "technician"', 'role = "viewer"'),
        ("unit_id = 2", "unit_id = 3"),
        ('name = "A"\n', 'name = "A"\n[bays.fusion]\ndistance_threshold_mm = 299.9\n'),
        ('name = "A"\n', 'name = "A"\n[bays.camera.controls]\ngain = 5\n'),
    ],
)
def test_what_is_set_counts(was: str, now: str) -> None:
    assert was in PLAIN
    assert of(PLAIN.replace(was, now)) != of(PLAIN)


def test_it_stays_the_same_over_versions() -> None:
    """A fleet keeps digests: a change here is one that every plant sees as drift."""
    assert of('site = "north"') == EXPECTED


EXPECTED = "43e523795c57ccb5de3a510e1a30a9a32319e61f80d135584304435f9afe53cf"
