"""Passwords of the pages' users: argon2id hashes, made by `gateway password` or for the settings page, and checked at
login. IO: a thread.

The memory and passes are the smallest that OWASP recommends (m=19 MiB, t=2, p=1): a check takes some tens of
milliseconds of one core, on a separate thread, one at a time, so that many logins take nothing away from
the pictures. An unknown user costs the same check as a known one.
"""

import asyncio
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, TypeVar

from argon2 import PasswordHasher, extract_parameters
from argon2.exceptions import VerifyMismatchError

from gateway.config.sections.hmi import HmiUser
from gateway.web.auth.refusals import AGAIN, RefusalError

MEMORY_KIB, PASSES, LANES = 19_456, 2, 1
MIN_LENGTH, MAX_LENGTH = 10, 256  # characters
MAX_WAITING = 8  # checks, the running one included
# What NIST SP 800-63B asks for: the commonest ones, sequences, and the words of this place.
COMMON = (
    *("password", "passwort", "letmein", "welcome", "changeme", "iloveyou", "secret", "default"),
    *("12345", "54321", "abcde", "qwert", "asdfg", "1q2w3e", "q1w2e3", "1qaz2wsx"),
    *("administrator", "admin", "technician", "operator", "gateway", "silo", "cement"),
)
REPEATED = re.compile(r"(.+?)\1+", re.DOTALL)
MIN_DIFFERENT = 5
Result = TypeVar("Result")


class LoginsBusyError(RefusalError):
    """Too many logins are being checked already."""

    def __init__(self) -> None:
        super().__init__(503, "busy", "too many logins at the same time; try again", headers=AGAIN)


def weakness(password: str, name: str = "") -> str | None:
    """Why a password is no good, in words for the one who typed it; None: it will do."""
    plain = normal(password)
    if len(plain) < MIN_LENGTH:
        return f"has {len(plain)} characters; at least {MIN_LENGTH} are needed. Three or four words are easy to keep"
    if len(plain) > MAX_LENGTH:
        return f"has {len(plain)} characters; at most {MAX_LENGTH} are taken"
    if not plain.isprintable():
        return "holds a character that cannot be typed into the login page"
    if len(set(plain)) < MIN_DIFFERENT:
        return f"uses {len(set(plain))} different characters; at least {MIN_DIFFERENT} are needed"
    return _guessable(plain.casefold(), name.casefold())


def _guessable(folded: str, name: str) -> str | None:
    if (repeated := REPEATED.fullmatch(folded)) and len(repeated[1]) < MIN_LENGTH:
        return f"is {repeated[1]!r} again and again"
    rest, found = folded, []
    for word in filter(None, (name, *COMMON)):
        if word in rest:
            rest = rest.replace(word, "")
            found.append(repr(word))
    if found and len(rest) < MIN_LENGTH - 3:
        return f"is little more than {' and '.join(found)}, which {'is' if len(found) == 1 else 'are'} tried first"
    return None


def hashed(password: str) -> str:
    """The text for `password_hash`, another each time. Takes some tens of milliseconds."""
    return PasswordHasher(time_cost=PASSES, memory_cost=MEMORY_KIB, parallelism=LANES).hash(normal(password))


def normal(password: str) -> str:
    """An ü is one letter or two, by keyboard; it is the same password."""
    return unicodedata.normalize("NFC", password)


class Passwords:
    """Checks logins. `close` when done with it."""

    def __init__(self, users: Iterable[HmiUser]) -> None:
        self._users: Mapping[str, HmiUser] = {user.name: user for user in users}
        self._dummy = _dummy_hash([user.password_hash for user in self._users.values()])
        self._thread: Executor = ThreadPoolExecutor(1, thread_name_prefix="passwords")
        self._waiting = 0

    async def check(self, name: str, password: str) -> HmiUser | None:
        """The user, if there is one of this name with this password. Raises LoginsBusyError when too many wait."""
        user = self._users.get(name)
        known = self._dummy if user is None else user.password_hash
        return user if await self._on_thread(_matches, known, password) and user is not None else None

    async def hash(self, password: str) -> str:
        """As `hashed`, in its turn among the checks. Raises LoginsBusyError when too many wait."""
        return await self._on_thread(hashed, password)

    async def _on_thread(self, work: Callable[..., Result], *given: str) -> Result:
        if self._waiting >= MAX_WAITING:
            raise LoginsBusyError
        self._waiting += 1
        job = self._thread.submit(work, *given)
        loop = asyncio.get_running_loop()
        job.add_done_callback(lambda done: self._done(done, loop))
        return await asyncio.wrap_future(job)

    def close(self) -> None:
        """Waits for the running check."""
        self._thread.shutdown(cancel_futures=True)

    def _done(self, job: Future[Any], loop: asyncio.AbstractEventLoop) -> None:
        """Counted when the thread is done with it, not when the requesting page has disconnected. Called on either
        thread."""
        if not loop.is_closed():
            loop.call_soon_threadsafe(self._one_less)

    def _one_less(self) -> None:
        self._waiting -= 1


def _matches(known: str, password: str) -> bool:
    if len(password) > MAX_LENGTH:
        return False
    try:
        return PasswordHasher().verify(known, normal(password).encode("utf-8", "surrogatepass"))
    except VerifyMismatchError:
        return False


def _dummy_hash(hashes: list[str]) -> str:
    """A hash that no password fits, as dear to check as the dearest of `hashes`."""
    made = [extract_parameters(known) for known in hashes]
    costliest = max(made, key=lambda found: found.memory_cost * found.time_cost, default=None)
    memory, passes, lanes = (
        (MEMORY_KIB, PASSES, LANES)
        if costliest is None
        else (costliest.memory_cost, costliest.time_cost, costliest.parallelism)
    )
    return f"$argon2id$v=19$m={memory},t={passes},p={lanes}${'A' * 22}${'A' * 43}"
