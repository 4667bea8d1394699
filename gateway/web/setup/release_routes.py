"""The checklist of a bay up to its release, and what was signed. The main process judges; `security` has checked who
calls."""

from typing import Any, Literal

from pydantic import Field, Json

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.ipc.messages import ActOnRelease, ReadRelease, ReleaseNow
from gateway.web.server.models import View
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.tuning.request_models import Body

ADDRESSES = ApiAddresses(
    "/api/bays/{bay}/release", least=Level.TECHNICIAN, errors={404: "no such bay", 503: "the gateway does not answer"}
)
UnixS = Field(description="Unix time, s; null: not yet")


class PolledView(View):
    """A PLC that polls."""

    address: str
    unix_s: float = Field(description="Unix time when it was last answered")
    rate_hz: float


class OutageView(View):
    """A sensor that was out under the function check, with stop on."""

    quality: str
    lost_unix_s: float
    good_unix_s: float | None = UnixS


class HeartbeatLossView(View):
    """The gateway was restarted while a PLC polled."""

    address: str
    before_unix_s: float
    after_unix_s: float | None = UnixS


class ChecklistView(View):
    """What was tried so far."""

    begun_unix_s: float
    by: str
    marker_unix_s: float | None = UnixS
    camera_out: OutageView | None
    ranger_out: OutageView | None
    more_rangers_out: list[OutageView | None] = Field(description="of the second and the third ranger")
    heartbeat: HeartbeatLossView | None
    confirmed: list[str]


class SignatureView(View):
    """A release that was signed."""

    unix_s: float
    who: str
    address: str
    checklist: ChecklistView
    polled: PolledView | None
    radius_px: float | None
    distance_mm: float | None
    void_unix_s: float | None = Field(description="not released any more since; null: it holds")
    void_keys: list[str] = Field(description="the keys that have changed")


class ReleaseView(View):
    """Where a bay stands between set up and released."""

    checklist: ChecklistView | None = Field(description="null: none is under way")
    done: dict[str, bool] = Field(description="every item of it, and whether it holds now")
    polled: PolledView | None = Field(description="null: no PLC polls")
    keys: dict[str, Json[Any]] = Field(description="the keys in force that a signature holds for")
    signed: list[SignatureView] = Field(description="the newest first")


class ReleaseBody(Body):
    """A step of a technician."""

    what: Literal["begin", "confirm", "sign", "discard"]
    item: Literal["", "heartbeat", "thresholds"] = Field("", description="that is confirmed")


@ADDRESSES.get("", "release", "the checklist of a bay up to its release, and what was signed")
async def _release(services: WebServices, bay: Bay, caller: RequestCaller) -> ReleaseView:
    return ReleaseView.model_validate(await services.client.ask(ReadRelease(bay.name), ReleaseNow, caller.writer))


@ADDRESSES.post(
    "",
    "act_on_release",
    "begin, confirm, sign or discard it",
    errors={409: "not now: an item is missing, or keys of the bay's decision wait for a restart"},
)
async def _act(services: WebServices, bay: Bay, caller: RequestCaller, body: ReleaseBody) -> ReleaseView:
    await services.client.command(ActOnRelease(bay.name, body.what, body.item), caller.writer)
    return await _release(services, bay, caller)
