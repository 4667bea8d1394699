"""Passwords typed into the settings page. Only the hash is kept, in memory, for a while; the page gets a name for it,
to be sent in the place of the hash. One event loop, no locks."""

import secrets
from collections import OrderedDict

from gateway.clock import Clock
from gateway.durations import NS_PER_S
from gateway.web.auth.login_throttle import LoginThrottle
from gateway.web.auth.passwords import Passwords, weakness
from gateway.web.auth.refusals import RefusalError, throttled
from gateway.web.auth.sessions import Caller
from gateway.web.profile.settings_edit import SettingChange

KEPT_S = 3600
MAX_KEPT = 64  # as many as there may be users
MARK = "new-password:"  # no hash begins so
KEY = ("hmi", "users", "password_hash")


class NewPasswords:
    """`keep` what was typed, then `filled_in` the changes that name it."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._throttle = LoginThrottle()  # of its own: who makes users must not be kept from logging in
        self._kept: OrderedDict[str, tuple[str, str, str, int]] = OrderedDict()  # owner, user, hash, until_ns

    async def keep(self, caller: Caller, user: str, password: str, passwords: Passwords) -> str:
        """A name for the hash of `user`'s new password, of use to this login alone. Raises RefusalError (400, 429,
        503)."""
        made = await self.hashed(caller, user, password, passwords)
        name = MARK + secrets.token_urlsafe(16)
        self._kept[name] = (caller.csrf, user, made, self._clock.now_ns() + KEPT_S * NS_PER_S)
        while len(self._kept) > MAX_KEPT:
            self._kept.popitem(last=False)
        return name

    async def hashed(self, caller: Caller, user: str, password: str, passwords: Passwords) -> str:
        """The hash itself. Raises as `keep`."""
        if (weak := weakness(password, user)) is not None:
            raise RefusalError(400, "password", f"this password {weak}")
        wait_s = self._throttle.attempt(caller.address, caller.name, self._clock.now_ns())
        if wait_s:
            raise throttled("passwords in a short time", wait_s)
        return await passwords.hash(password)

    def filled_in(self, caller: Caller, change: SettingChange) -> SettingChange:
        """With the hash that it names. Raises RefusalError (409)."""
        named = isinstance(change.value, str) and change.value.startswith(MARK)
        if not named or len(change.path) != 4 or (*change.path[:2], change.path[3]) != KEY:
            return change
        owner, user, made, until_ns = self._kept.get(change.value, ("", "", "", 0))
        if (owner, user) != (caller.csrf, change.path[2]) or self._clock.now_ns() >= until_ns:
            raise RefusalError(
                409, "password", f"the new password of {change.path[2]} is not known any more: type it again"
            )
        return SettingChange(change.path, made)
