"""How often a login may fail. Numbers by hand: 10 at once, then one in 30 s by address and one in 60 s by name."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.net.rate_limit import Rate
from gateway.web.auth import login_throttle
from gateway.web.auth.login_throttle import BY_ADDRESS, LoginThrottle, spelled

S = 1_000_000_000


def fails(throttle: LoginThrottle, address: str, name: str, times: int, now_ns: int = 0) -> list[int]:
    return [throttle.attempt(address, name, now_ns) for _ in range(times)]


def test_one_address_many_names() -> None:
    throttle = LoginThrottle()
    assert [throttle.attempt("10.0.0.9", f"name {n}", 0) for n in range(12)] == [0] * 10 + [30, 30]
    assert throttle.attempt("10.0.0.9", "name 12", 29 * S) == 1
    assert throttle.attempt("10.0.0.9", "name 13", 30 * S) == 0
    assert throttle.attempt("10.0.0.9", "name 14", 30 * S) == 30
    assert throttle.attempt("10.0.0.8", "name 15", 30 * S) == 0
    assert fails(throttle, "10.0.0.9", "x", 12, 400 * S) == [0] * 10 + [60, 60]  # full again, then the name's turn


def test_one_name_many_addresses() -> None:
    throttle = LoginThrottle()
    assert [throttle.attempt(f"10.0.0.{n}", "anna", 0) for n in range(12)] == [0] * 10 + [60, 60]
    assert throttle.attempt("10.0.0.99", "bert", 0) == 0
    assert throttle.attempt("10.0.0.99", "anna", 60 * S) == 0


def test_many_names_and_many_addresses() -> None:
    throttle = LoginThrottle()
    answer = [throttle.attempt(f"10.0.{n}.1", f"name {n}", 0) for n in range(200)]
    assert answer == [0] * 60 + [1] * 140
    assert throttle.attempt("10.1.0.1", "new", S) == 0
    assert throttle.attempt("10.1.0.1", "new", S) == 1


@pytest.mark.parametrize("every", [1, 2])
def test_one_valid_account_does_not_give_back_what_the_others_have_cost(every: int) -> None:
    """Somebody with an account of the lowest role logs in between guesses at the others."""
    throttle = LoginThrottle()
    passed = dict.fromkeys(("anna", "bert", "tom"), 0)
    for n in range(1000):
        if n % every == 0 and throttle.attempt("10.0.0.9", "low", 0) == 0:
            throttle.succeeded("10.0.0.9", "low", 0)
        for name in passed:
            passed[name] += throttle.attempt("10.0.0.9", name, 0) == 0
    assert sum(passed.values()) == 10


def test_failures_of_others_do_not_lock_the_owner_out() -> None:
    throttle = LoginThrottle()
    assert throttle.attempt("10.0.0.9", "anna", 0) == 0
    throttle.succeeded("10.0.0.9", "anna", 0)
    for n in range(500):  # from everywhere, until the bucket of the name and the one for all are empty
        throttle.attempt(f"10.1.{n % 250}.{n}", "anna", 0)
        throttle.attempt(f"10.1.{n % 250}.{n}", f"name {n}", 0)
    assert throttle.attempt("10.0.0.7", "anna", 0) > 0
    assert throttle.attempt("10.0.0.9", "anna", 0) == 0
    assert fails(throttle, "10.0.0.9", "anna", 10) == [0] * 9 + [30]  # and its own address is held short, too


def test_a_name_is_known_at_its_last_four_places() -> None:
    throttle = LoginThrottle()
    for n in range(5):
        throttle.succeeded(f"10.0.0.{n}", "anna", 0)
    fails(throttle, "10.9.9.9", "anna", 10)
    waits = [throttle.attempt(f"10.0.0.{n}", "anna", 0) for n in range(5)]
    assert waits == [60, 0, 0, 0, 0]


def test_memory_is_bounded_and_a_flood_does_not_reset_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(login_throttle, "IN_ALL", Rate(1_000_000, 1_000_000))
    monkeypatch.setattr(login_throttle, "MAX_KEYS", 100)
    throttle = LoginThrottle()
    for n in range(5000):
        throttle.attempt(f"10.{n // 250}.{n % 250}.1", f"name {n}", n)
    assert len(throttle._addresses) + len(throttle._names) <= 200
    assert fails(throttle, "10.200.0.1", "anna", 11, 5000)[-1] > 0


@pytest.mark.parametrize(
    ("address", "spelling"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("::ffff:10.0.0.7", "10.0.0.7"),
        ("FE80:0:0::1%eth0", "fe80::1"),
        ("2001:db8::1", "2001:db8::1"),
        ("?", "?"),
        ("x" * 500, "x" * 64),
    ],
)
def test_one_spelling_for_one_address(address: str, spelling: str) -> None:
    assert spelled(address) == spelling


@pytest.mark.one_interpreter
@given(st.lists(st.tuples(st.sampled_from("ab"), st.sampled_from("xy"), st.integers(0, 20 * S), st.booleans())))
def test_failures_never_outrun_the_allowance(steps: list[tuple[str, str, int, bool]]) -> None:
    """Whatever the order: in no span did more failures pass than the burst and one for each period of it."""
    throttle = LoginThrottle()
    now_ns = 0
    passed: dict[str, list[int]] = {"a": [], "b": []}
    for address, name, later_ns, right in steps:
        now_ns += later_ns
        if throttle.attempt(address, name, now_ns) == 0:
            if right:
                throttle.succeeded(address, name, now_ns)
            else:
                passed[address].append(now_ns)
    for times in passed.values():
        for first, begin_ns in enumerate(times):
            for last in range(first, len(times)):
                span_s = (times[last] - begin_ns) / S
                assert last - first + 1 <= BY_ADDRESS.burst + span_s * S / BY_ADDRESS.period_ns + 1e-6
