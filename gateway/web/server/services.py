"""What the routes of the web process work with, and how FastAPI gives it to them."""

import asyncio
from collections import Counter
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Path
from starlette.requests import HTTPConnection, Request

from gateway.clock import Clock
from gateway.config import BayConfig
from gateway.records.questions import Question
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller, caller_of
from gateway.web.calibration.sessions import Calibrations
from gateway.web.helper_client import READER, UPDATES, HelperClient
from gateway.web.history.records_thread import RecordsThread
from gateway.web.ipc.updates import UpdatesQuestion
from gateway.web.languages import Languages, languages, of_memory
from gateway.web.server import views
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.live import Live
from gateway.web.server.metrics.family import PageStatistics
from gateway.web.server.pictures import Pictures
from gateway.web.setup.device_client import DeviceClient
from gateway.web.setup.new_passwords import NewPasswords
from gateway.web.testsets.client import SetsClient
from gateway.web.testsets.scoring_service import ScoringService
from gateway.web.tuning.teach_in import TeachInSessions
from gateway.web.tuning.tuning_service import TuningService


@dataclass(frozen=True, slots=True)
class Services:
    """One for the web process. `refusals`: by code, since the start."""

    client: GatewayClient
    pictures: Pictures
    live: Live
    drivers: Live
    alarms: Live
    tuning: TuningService
    test_sets: ScoringService
    teach_ins: TeachInSessions
    calibrations: Calibrations
    snapshots: Executor  # encodes the programs' snapshots
    records: RecordsThread
    reader: HelperClient[Question]
    devices: DeviceClient
    languages: Languages
    new_passwords: NewPasswords
    updates: HelperClient[UpdatesQuestion]
    encoding: asyncio.Lock = field(default_factory=asyncio.Lock)
    refusals: Counter[str] = field(default_factory=Counter)

    def statistics(self) -> PageStatistics:
        viewers = {"live": self.live.counts, "driver": self.drivers.counts, "alarms": self.alarms.counts}
        return PageStatistics(viewers, self.pictures.encoded, self.refusals)


def services_of(client: GatewayClient, pace: Clock, thread: Executor | None = None) -> Services:
    """`thread`: for pictures and texts; by default each service has its own."""
    config = client.about.config.hmi
    tuning = TuningService(client, pace, thread)
    test_sets = ScoringService(SetsClient(client.about.test_sets), tuning.trial_thread, pace)
    tuning.also_standing = test_sets.standing
    return Services(
        client=client,
        pictures=Pictures(client, pace, max_hz=config.picture_max_hz, max_width_px=config.picture_max_width_px),
        live=Live(client, views.live_json, config.max_viewers, config.viewers_per_address),
        drivers=Live(client, views.driver_json, config.max_viewers, config.viewers_per_address),
        alarms=Live(client, views.alarms_json, config.max_viewers, config.viewers_per_address, urgent=False),
        tuning=tuning,
        test_sets=test_sets,
        teach_ins=TeachInSessions(client),
        calibrations=Calibrations(client, pace, tuning.trial_thread),
        snapshots=thread or ThreadPoolExecutor(1, thread_name_prefix="snapshots"),
        records=RecordsThread.of(client.about.config, thread),
        reader=HelperClient(READER, client.about.questions),
        devices=DeviceClient(client.about.devices),
        languages=languages(of_memory(client.about.languages)),
        new_passwords=NewPasswords(pace),
        updates=HelperClient(UPDATES, client.about.updates),
    )


# Dependencies of the routes. All are coroutines: FastAPI would run plain functions on threads.


async def _services(connection: HTTPConnection) -> Services:
    services: Services = connection.app.state.services
    return services


WebServices = Annotated[Services, Depends(_services)]


async def _caller(request: Request) -> Caller:
    return caller_of(request.scope)


RequestCaller = Annotated[Caller, Depends(_caller)]


async def _bay(
    services: WebServices, bay: Annotated[str, Path(min_length=1, description="name of the bay")]
) -> BayConfig:
    for config in services.client.about.config.bays:
        if config.name == bay:
            return config
    raise RefusalError(404, "bay", f"there is no bay {bay[:100]!r}")


Bay = Annotated[BayConfig, Depends(_bay)]
