"""Who is logged in, and how long."""

import asyncio
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.config.sections.hmi import HmiConfig
from gateway.web.auth.access import Level
from gateway.web.auth.logins import Logins
from gateway.web.auth.passwords import hashed
from gateway.web.auth.sessions import MAX_PER_USER, MAX_SESSIONS, Session, Sessions
from gateway.web.host.startup import LOGIN, Restart, Startup
from tests.unit.web.auth import USERS

S = 1_000_000_000
HOUR = 3600 * S


def sessions(ended: list[str] | None = None) -> Sessions:
    numbers = itertools.count(1)
    ends = ended if ended is not None else []
    return Sessions(
        lifetime_ns=12 * HOUR, idle_ns=HOUR, ended=ends.append, token=lambda size: f"token {next(numbers)}/{size}"
    )


def test_a_session_from_its_begin_to_its_end() -> None:
    ended: list[str] = []
    book = sessions(ended)
    identity, session = book.open("anna", Level.VIEWER, 5 * S)
    assert (identity, session.csrf) == ("token 1/32", "token 2/32")
    assert identity not in repr(session)  # whoever reads the memory, or a log of it, can't use it
    found = book.find(identity, 7 * S)
    assert found is not None
    assert (found.key, found.user, found.level) == (session.key, "anna", Level.VIEWER)
    assert (found.opened_ns, found.seen_ns) == (5 * S, 7 * S)
    assert book.find("token 2/32", 7 * S) is None
    assert book.find(session.key, 7 * S) is None
    assert book.find("", 7 * S) is None
    assert book.find("x" * 10_000, 7 * S) is None
    book.close(session.key)
    book.close(session.key)
    assert ended == [session.key]
    assert book.find(identity, 8 * S) is None
    assert len(book) == 0


def test_real_ids_are_long_and_never_the_same() -> None:
    book = Sessions(lifetime_ns=HOUR, idle_ns=HOUR)
    made = [book.open(f"user{n}", Level.VIEWER, 0) for n in range(100)]
    ids = {identity for identity, _ in made} | {session.csrf for _, session in made}
    assert len(ids) == 200
    assert all(len(identity) == 43 for identity in ids)  # 256 bits


def test_one_user_has_so_many_and_the_one_seen_longest_ago_goes() -> None:
    ended: list[str] = []
    book = sessions(ended)
    made = [book.open("anna", Level.VIEWER, n * S) for n in range(MAX_PER_USER)]
    book.find(made[0][0], 100 * S)
    book.open("anna", Level.VIEWER, 101 * S)
    assert ended == [made[1][1].key]
    assert len(book) == MAX_PER_USER


def test_all_together_have_so_many() -> None:
    ended: list[str] = []
    book = sessions(ended)
    made = [book.open(f"user {n}", Level.VIEWER, n) for n in range(MAX_SESSIONS)]
    assert ended == []
    book.open("one more", Level.VIEWER, MAX_SESSIONS)
    assert ended == [made[0][1].key]
    assert len(book) == MAX_SESSIONS


def test_expired_sessions_are_removed_without_a_request() -> None:
    ended: list[str] = []
    book = sessions(ended)
    for n in range(5):
        book.open(f"user {n}", Level.VIEWER, n)
    book.open("late", Level.VIEWER, HOUR + 10)
    assert len(ended) == 5
    assert len(book) == 1


@pytest.mark.one_interpreter
@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 20), st.integers(0, HOUR)), max_size=60))
def test_never_more_than_allowed_and_each_end_is_reported_once(steps: list[tuple[str, int, int]]) -> None:
    ended: list[str] = []
    book = sessions(ended)
    made: list[tuple[str, str]] = []
    now_ns = 0
    for user, which, later_ns in steps:
        now_ns += later_ns
        if which % 3 or not made:
            identity, session = book.open(user, Level.VIEWER, now_ns)
            made.append((identity, session.key))
        elif which % 2:
            book.find(made[which % len(made)][0], now_ns)
        else:
            book.close(made[which % len(made)][1])
    book.remove_expired(now_ns)
    alive = [key for identity, key in made if book.find(identity, now_ns) is not None]
    assert len(alive) == len(book)
    assert len(ended) == len(set(ended))
    assert sorted([*ended, *alive]) == sorted(key for _, key in made)


def with_user(
    name: str = "tom", role: str = "technician", password_hash: str = USERS[1].password_hash
) -> GatewayConfig:
    user = {"name": name, "role": role, "password_hash": password_hash}
    return GatewayConfig.model_validate({"hmi": {"users": [user]}})


def handed_on(login: Session | None, before: GatewayConfig) -> str:
    """As the next start finds it in its environment."""
    restart = Restart(asyncio.Event())
    requested = Startup(restart=restart).restart_of(lambda: before)
    assert requested is not None
    requested(login)
    assert restart.requested
    assert restart.stop.is_set()
    return restart.environment.get(LOGIN, "")


def test_whoever_has_the_gateway_start_again_stays_logged_in() -> None:
    identity, session = sessions().open("tom", Level.TECHNICIAN, 5 * S)
    text = handed_on(session, with_user())
    assert identity not in text
    kept = Startup(login=text).login_of(with_user())
    assert kept == session
    book = sessions()
    book.resume(kept)
    assert book.find(identity, 5 * S + HOUR - 1) is not None
    assert book.find(identity, 5 * S + 12 * HOUR) is None  # as if it had never moved


@pytest.mark.parametrize(
    "after",
    [with_user(name="tim"), with_user(role="viewer"), with_user(password_hash=hashed("lime-kiln-dust-77"))],
    ids=["name", "role", "password"],
)
def test_nobody_stays_logged_in_over_a_change_of_users(after: GatewayConfig) -> None:
    _, session = sessions().open("tom", Level.TECHNICIAN, 5 * S)
    assert Startup(login=handed_on(session, with_user())).login_of(after) is None


@pytest.mark.parametrize("text", ["", "{}", '["", {}]', "\x00", '["a"]'])
def test_what_is_no_login_is_none(text: str) -> None:
    assert Startup(login=text).login_of(with_user()) is None


def test_a_restart_without_a_login_hands_none_on() -> None:
    assert handed_on(None, with_user()) == ""


@pytest.mark.parametrize(
    ("user", "level", "stays"),
    [
        ("tom", Level.TECHNICIAN, True),
        ("vera", Level.TECHNICIAN, False),
        ("tom", Level.VIEWER, False),
        ("tim", Level.TECHNICIAN, False),
    ],
)
def test_only_a_user_in_the_same_role_stays_logged_in(user: str, level: Level, *, stays: bool) -> None:
    _, session = sessions().open(user, level, 5 * S)
    logins = Logins(HmiConfig(users=USERS), SystemClock(), lambda _: None)
    logins.resume(session)
    assert len(logins.sessions) == stays
    logins.close()
