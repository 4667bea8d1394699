"""Passwords: which are taken, what is kept of them, and that a login does not hold anybody up."""

import asyncio
import tomllib

import pytest

from gateway.cli.main import main
from gateway.config import parse
from gateway.config.sections.hmi import HmiUser
from gateway.web.auth import passwords
from gateway.web.auth.passwords import MAX_WAITING, LoginsBusyError, Passwords, hashed, weakness
from tests.unit.web.auth import HASH, PASSWORD, USERS
from tests.virtual_time import in_real_time


@pytest.mark.parametrize(
    ("password", "expected"),
    [
        ("", "has 0 characters; at least 10 are needed"),
        ("xK7#pq2!z", "has 9 characters; at least 10"),
        ("a" * 257, "has 257 characters; at most 256"),
        ("abababababab", "uses 2 different characters; at least 5"),
        ("correct\thorse battery", "cannot be typed"),
        ("password123", "is little more than 'password'"),
        ("PassWort2026!", "is little more than 'passwort'"),
        ("1234567890", "is little more than '12345'"),
        ("annamaria12", "is little more than 'annamaria'"),
        ("passwordpassword", "is 'password' again and again"),
        ("SpoutSPOUT", "is 'spout' again and again"),
        ("passwordpassword1", "is little more than 'password', which is tried first"),
        ("gatewaypassword", "is little more than 'password' and 'gateway', which are tried first"),
        ("abcdefghij", "is little more than 'abcde'"),
        ("administrator1", "is little more than 'administrator'"),
    ],
)
def test_weak_passwords(password: str, expected: str) -> None:
    found = weakness(password, "annamaria")
    assert found is not None
    assert expected in found


@pytest.mark.parametrize(
    "password",
    [
        PASSWORD,
        "Xk7#pq2!zR",
        "Straßenbahn im Regen",
        "ключ от силоса",
        "annamaria wohnt am Fluss",
        "horse-7-dust horse-7-dust",
    ],
)
def test_good_passwords(password: str) -> None:
    assert weakness(password, "annamaria") is None


def test_a_hash_is_another_each_time_and_the_configuration_takes_it() -> None:
    first, second = hashed(PASSWORD), hashed(PASSWORD)
    assert first != second
    assert first.startswith("$argon2id$v=19$m=19456,t=2,p=1$")
    assert PASSWORD not in first
    HmiUser(name="anna", password_hash=first)


def checked(users: tuple[HmiUser, ...], *tries: tuple[str, str]) -> list[str | None]:
    async def checking() -> list[str | None]:
        book = Passwords(users)
        try:
            found = [await book.check(*one) for one in tries]
            return [None if user is None else user.name for user in found]
        finally:
            book.close()

    return asyncio.run(checking())


def test_right_and_wrong() -> None:
    tries = [
        ("tom", PASSWORD), ("tom", PASSWORD + " "), ("tom", ""), ("Tom", PASSWORD), ("nobody", PASSWORD), ("", ""),
        ("tom", "\ud800"), ("tom", "x" * 1_000_000), ("vera", PASSWORD),
    ]  # fmt: skip
    assert checked(USERS, *tries) == ["tom", *[None] * 7, "vera"]


def test_one_letter_typed_in_two_ways_is_the_same_password() -> None:
    user = HmiUser(name="anna", password_hash=hashed("Gr\u00fcn sind die T\u00e4ler"))
    assert checked((user,), ("anna", "Gru\u0308n sind die Ta\u0308ler")) == ["anna"]


@pytest.mark.parametrize("users", [USERS, ()])
def test_an_unknown_user_costs_the_same_work(users: tuple[HmiUser, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted, not timed: the hash that is checked for a stranger asks for the same memory and passes."""
    seen: list[str] = []
    real = passwords._matches

    def fits(known: str, password: str) -> bool:
        seen.append(known)
        return real(known, password)

    monkeypatch.setattr(passwords, "_matches", fits)
    assert checked(users, ("tom", "wrong password"), ("nobody", "wrong password"))[1] is None
    assert len(seen) == 2
    assert seen[0].split("$")[:4] == seen[1].split("$")[:4]
    assert [len(part) for part in seen[1].split("$")[4:]] == [22, 43]


def test_the_costliest_hash_sets_what_an_unknown_user_costs() -> None:
    dear = HmiUser(name="dear", password_hash=HASH.replace("m=19456,t=1", "m=20000,t=3"))
    assert passwords._dummy_hash([HASH, dear.password_hash]).split("$")[3] == "m=20000,t=3,p=1"


@pytest.mark.one_interpreter
def test_the_event_loop_goes_on_and_too_many_checks_are_refused() -> None:
    async def checking() -> None:
        book = Passwords(USERS)
        turns = 0

        async def turn() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        try:
            async with asyncio.TaskGroup() as group:
                other = group.create_task(turn())
                found = await asyncio.gather(
                    *(book.check("tom", PASSWORD) for _ in range(3 * MAX_WAITING)), return_exceptions=True
                )
                other.cancel()
            done = [user for user in found if isinstance(user, HmiUser)]
            assert len(done) == MAX_WAITING
            assert sum(isinstance(user, LoginsBusyError) for user in found) == 2 * MAX_WAITING
            assert turns > 10 * MAX_WAITING  # blocked, it would be about one a check
            async with asyncio.timeout(60):
                while book._waiting:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
            assert await book.check("tom", PASSWORD) is not None  # and then there is room again
        finally:
            book.close()

    asyncio.run(checking())


@in_real_time
async def test_a_page_that_goes_away_leaves_no_room_taken() -> None:
    book = Passwords(USERS)
    try:
        for _ in range(3):
            tasks = [asyncio.ensure_future(book.check("tom", PASSWORD)) for _ in range(MAX_WAITING)]
            await asyncio.sleep(0)
            for task in tasks:
                task.cancel()
            async with asyncio.timeout(60):
                while book._waiting:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
    finally:
        book.close()


# The verb


def test_the_printed_user_can_log_in(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("getpass.getpass", lambda _: PASSWORD)
    assert main(["password", "anna", "--role", "technician"]) == 0
    output = capsys.readouterr()
    (user,) = parse(tomllib.loads(output.out), text=output.out).hmi.users
    assert (user.name, user.role) == ("anna", "technician")
    assert PASSWORD not in output.out + output.err
    assert checked((user,), ("anna", PASSWORD), ("anna", "wrong password")) == ["anna", None]


def test_two_different_passwords(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    typed = iter([PASSWORD, PASSWORD + "x"])
    monkeypatch.setattr("getpass.getpass", lambda _: next(typed))
    assert main(["password", "anna"]) == 2
    output = capsys.readouterr()
    assert "two different passwords; nothing was made" in output.err
    assert output.out == ""


@pytest.mark.parametrize(
    ("data", "code", "expected"),
    [
        (b"correct horse battery\n", 0, ""),
        (b"correct horse battery\r\n", 0, ""),
        (b"correct horse battery", 0, ""),
        (b"short\n", 2, "this password has 5 characters; at least 10 are needed"),
        (b"", 2, "should be one line with the password"),
        (b"correct horse battery\nmore\n", 2, "should be one line with the password"),
        (b"\xff\xfe" * 10, 2, "not UTF-8 text"),
        (b"x" * 5000, 2, "should be one line with the password"),
    ],
)
def test_from_a_pipe(
    data: bytes, code: int, expected: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import io

    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(data)))
    assert main(["password", "anna", "--stdin"]) == code
    out, err = capsys.readouterr()
    assert expected in err
    assert ("[[hmi.users]]" in out) == (code == 0)


@pytest.mark.parametrize("name", ["an na", "", "a" * 65, 'a"b', "änna", "anna\n"])
def test_invalid_user_names(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["password", name, "--stdin"]) == 2
    assert "1 to 64 letters" in capsys.readouterr().err


def test_no_password_is_read_where_the_echo_cannot_be_switched_off(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where the echo can't be switched off, nothing is typed."""
    import getpass
    import warnings

    def would_show(_: str) -> str:
        warnings.warn("Can not control echo on the terminal.", getpass.GetPassWarning, stacklevel=2)
        return PASSWORD

    monkeypatch.setattr("getpass.getpass", would_show)
    assert main(["password", "anna"]) == 2
    assert "no terminal; --stdin" in capsys.readouterr().err
