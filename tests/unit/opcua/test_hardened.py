"""Limits against clients that are wrong, slow or hostile."""

import asyncio
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.ua.ua_binary import nodeid_to_binary, struct_from_binary, struct_to_binary

from gateway.alarms.records import Alarm, AlarmSummary
from gateway.alarms.states import AlarmState
from gateway.core.readings import Quality, RangeReading
from gateway.opcua.hardened import (
    CHUNK_BYTES,
    MAX_OPERATIONS,
    MAX_QUEUE,
    MIN_PUBLISHING_MS,
    LimitedConnection,
    LimitedSession,
    LimitedSessions,
    Unproven,
)
from gateway.web.ipc.messages import SystemStatus
from tests.plant_certs import Plant
from tests.unit.opcua.server import OpcuaServer, good

pytestmark = [pytest.mark.one_interpreter, pytest.mark.xdist_group("opcua")]
HELLO = struct.pack("<4sIIIIII", b"HELF", 32, 0, 65536, 65536, 0, 0) + struct.pack("<i", -1)


def request(variant: bytes) -> bytes:
    """Of somebody without a channel or session: GetEndpoints, with a literal in the header's addition."""
    kinds = ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary, ua.ObjectIds.LiteralOperand_Encoding_DefaultBinary
    kind, literal = (nodeid_to_binary(ua.NodeId(one)) for one in kinds)
    header = bytes(18) + struct.pack("<iI", -1, 0) + literal + b"\x01" + struct.pack("<i", len(variant)) + variant
    body = struct.pack("<IIII", 0, 0, 1, 1) + kind + header
    return struct.pack("<4sI", b"MSGF", 8 + len(body)) + bytes(body)


@pytest.fixture(scope="module")
def server() -> Iterator[OpcuaServer]:
    made = OpcuaServer({"opcua": {"without_security": True, "max_connections": 3, "max_monitored_items": 5}})
    sessions: LimitedSessions = made.served.server.iserver
    sessions.max_subscriptions, sessions.max_pending_activation_seconds = 2, 1.0
    made.show(good(made.main.clock.now_ns()))
    yield made
    made.close()


def address(server: OpcuaServer) -> tuple[str, int]:
    host, port = server.sockets[0].getsockname()
    return str(host), int(port)


def closed(connection: socket.socket) -> bool:
    """Waits for it."""
    connection.settimeout(10)
    try:
        while connection.recv(65536):
            pass
    except ConnectionError:
        pass
    return True


def code(error: pytest.ExceptionInfo[Any]) -> int:
    return int(error.value.code)


def test_a_connection_that_says_nothing_is_closed(server: OpcuaServer) -> None:
    with socket.create_connection(address(server)) as silent:
        assert closed(silent)


def test_a_connection_beyond_the_limit_is_closed_at_once(server: OpcuaServer) -> None:
    held = [socket.create_connection(address(server)) for _ in range(3)]
    for one in held:
        one.sendall(HELLO)
        assert one.recv(3) == b"ACK"
    with socket.create_connection(address(server)) as further:
        assert closed(further)
    for one in held:
        assert closed(one)
        one.close()
    now = server.served.server.iserver.now(4840)
    assert (now.over_limit, now.protocol_faults, now.certificates_refused) == (1, 0, 0)


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<4sI", b"MSGF", 0x7FFFFFFF) + bytes(CHUNK_BYTES + 1),  # a chunk of 2 GB
        struct.pack("<4sI", b"MSGF", 11),  # shorter than its header
        struct.pack("<4sI", b"HELF", 7),
        struct.pack("<4sIII", b"MSGF", 24, 77, 0) + bytes(8),  # of another channel
        struct.pack("<4sI", b"OPNF", 64) + b"\xff" * 56,
        request(struct.pack("<Bi", 0x80, 3_000_000)),  # an array of elements without bytes
        request(struct.pack("<Biii", 0x80 | 15, 3_000_000, -4, -4)),  # a length that leads back to itself
        request(struct.pack("<Biiii", 0x80 | 0x40 | 1, 0, 2, 1, 1_000_000)),  # a matrix of nothing
        request(b"\x0f" + struct.pack("<i", 16_384) + bytes(16_384)),  # long, of nobody known
        struct.pack("<4sI5Ii", b"HELF", 32, 0, 8191, 65536, 0, 0, -1),  # takes small chunks only
        b"GET / HTTP/1.1\r\nHost: a\r\n\r\n" + bytes(CHUNK_BYTES),
    ],
)
def test_what_breaks_the_protocol_ends_its_connection(server: OpcuaServer, data: bytes) -> None:
    sessions: LimitedSessions = server.served.server.iserver
    faults = sessions.protocol_faults
    with socket.create_connection(address(server)) as wrong:
        wrong.sendall(HELLO)
        assert wrong.recv(3) == b"ACK"
        with suppress(ConnectionError):
            wrong.sendall(data)
        assert closed(wrong)
    assert sessions.protocol_faults == faults + 1


async def with_client(server: OpcuaServer, work: Any) -> Any:
    async with Client(server.url) as client:
        return await work(client)


def test_subscriptions_and_monitored_items_are_limited(server: OpcuaServer) -> None:
    async def work(client: Client) -> Any:
        first = await client.create_subscription(1, _Ignored())
        assert first.parameters.RequestedPublishingInterval == MIN_PUBLISHING_MS  # as revised
        second = await client.create_subscription(500, _Ignored())
        with pytest.raises(ua.UaStatusCodeError) as third:
            await client.create_subscription(500, _Ignored())
        names = ("stop", "may_move", "in_place", "reason", "phase", "moved")
        found = [client.get_node(f"ns=2;s=bay1.{name}") for name in names]
        await first.subscribe_data_change(found[:3])
        with pytest.raises(ua.UaStatusCodeError) as items:
            await second.subscribe_data_change(found[3:])
        return third, items

    third, items = asyncio.run(with_client(server, work))
    assert code(third) == ua.StatusCodes.BadTooManySubscriptions
    assert code(items) == ua.StatusCodes.BadTooManyMonitoredItems


def test_another_sessions_subscription_can_be_neither_changed_nor_taken(server: OpcuaServer) -> None:
    async def work(client: Client) -> list[int]:
        own = await client.create_subscription(100, _Ignored())
        number = own.subscription_id
        codes = []
        async with Client(server.url) as other:
            api = other.uaclient
            transfer = ua.TransferSubscriptionsParameters([number], False)
            calls: tuple[Any, ...] = (
                lambda: api.delete_subscriptions([number]),
                lambda: api.transfer_subscriptions(transfer),
                lambda: api.create_monitored_items(ua.CreateMonitoredItemsParameters(number)),
                lambda: api.delete_monitored_items(ua.DeleteMonitoredItemsParameters(number, [112])),
            )
            for call in calls:
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await call()
                codes.append(code(refused))
        return codes

    codes = asyncio.run(with_client(server, work))
    foreign = int(ua.StatusCodes.BadSubscriptionIdInvalid)
    assert codes == [foreign, int(ua.StatusCodes.BadServiceUnsupported), foreign, foreign]


def test_nothing_is_left_of_a_session_that_is_closed_or_replaced(server: OpcuaServer) -> None:
    """Its subscriptions would keep their places, and its tasks would be as many as a client likes."""

    sessions: LimitedSessions = server.served.server.iserver

    async def now() -> tuple[int, int, int]:
        tasks = [str(task.get_coro()) for task in asyncio.all_tasks()]
        watchdogs = sum("_session_watchdog_loop" in task for task in tasks)
        return len(sessions._external_sessions), len(sessions.subscription_service.subscriptions), watchdogs

    def left(wanted: tuple[int, int, int]) -> tuple[int, int, int]:
        """A task that was cancelled ends a little later."""
        deadline = time.monotonic() + 30
        while (found := server.run(now())) != wanted and time.monotonic() < deadline:
            time.sleep(0.01)
        return found

    async def work(client: Client) -> tuple[int, int, int]:
        for _ in range(3):
            await client.create_subscription(3_600_000, _Ignored())
            await client.create_session()
            await client.activate_session()
        await client.create_subscription(3_600_000, _Ignored())
        held = left((1, 1, 1))
        await client.uaclient.close_session(False)
        return held

    assert left((0, 0, 0)) == (0, 0, 0)
    assert asyncio.run(with_client(server, work)) == (1, 1, 1)
    assert left((0, 0, 0)) == (0, 0, 0)


def test_a_session_that_has_made_room_can_not_be_activated(server: OpcuaServer) -> None:
    async def work(client: Client) -> int:
        await client.create_session()
        for one in server.served.server.iserver._external_sessions.values():
            one._last_activity -= 60.0
        async with Client(server.url):
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await client.activate_session()
        return code(refused)

    assert asyncio.run(with_client(server, work)) == ua.StatusCodes.BadSessionIdInvalid


def test_what_was_sent_is_sent_again_and_what_is_gone_is_said_to_be(server: OpcuaServer) -> None:
    """With the library's empty answer a client would not know that it had missed a value."""

    async def work(client: Client) -> tuple[list[int], int]:
        told: asyncio.Queue[Any] = asyncio.Queue()

        class Told:
            def datachange_notification(self, *_: Any) -> None:
                told.put_nowait(None)

        own = await client.create_subscription(100, Told())
        sent = server.served.server.iserver.subscription_service.subscriptions[own.subscription_id]
        sent.publish = lambda acks: None  # the client acknowledges at once
        await own.subscribe_data_change(client.get_node("ns=2;s=bay1.stop"))
        await asyncio.wait_for(told.get(), 10)
        request = ua.RepublishRequest()
        found = []
        for number in (1, 1, 2):
            request.Parameters = ua.RepublishParameters(own.subscription_id, number)
            with suppress(ua.UaStatusCodeError):
                answer = await client.uaclient.protocol.send_request(request)
                found.append(struct_from_binary(ua.RepublishResponse, answer).NotificationMessage.SequenceNumber)
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await client.uaclient.protocol.send_request(request)
        return found, code(refused)

    found = asyncio.run(with_client(server, work))
    assert found == ([1, 1], int(ua.StatusCodes.BadMessageNotAvailable))


def test_conditions_are_refreshed_for_the_subscriptions_session_only(server: OpcuaServer) -> None:
    async def work(client: Client) -> list[int]:
        own = await client.create_subscription(3_600_000, _Ignored())
        number = ua.Variant(own.subscription_id, ua.VariantType.UInt32)
        kinds = ua.ObjectIds.ConditionType_ConditionRefresh, ua.ObjectIds.ConditionType_ConditionRefresh2
        calls = [ua.CallMethodRequest(ua.NodeId(ua.ObjectIds.ConditionType), ua.NodeId(one), [number]) for one in kinds]
        codes = []
        async with Client(server.url) as other:
            for call in calls:
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await other.uaclient.call([call])
                codes.append(code(refused))
        return [*codes, *(one.StatusCode.value for one in await client.uaclient.call(calls))]

    foreign = int(ua.StatusCodes.BadSubscriptionIdInvalid)
    assert asyncio.run(with_client(server, work)) == [foreign, foreign, 0, 0]


def test_a_request_has_a_limited_number_of_operations(server: OpcuaServer) -> None:
    """Each of these would hold up everybody for seconds."""

    async def work(client: Client) -> list[int]:
        many, api = MAX_OPERATIONS + 1, client.uaclient
        node, kind = client.get_node("ns=2;s=bay1.stop"), ua.NodeId(ua.ObjectIds.BaseDataType)
        step = ua.RelativePathElement(TargetName=ua.QualifiedName("Structure"))
        write = ua.WriteValue(node.nodeid, ua.AttributeIds.Value)
        browse = ua.BrowseDescription(ua.NodeId(ua.ObjectIds.Structure), ua.BrowseDirection.Both)
        calls: tuple[Any, ...] = (
            lambda: client.read_values([node] * many),
            lambda: api.write(ua.WriteParameters([write] * many)),
            lambda: api.translate_browsepaths_to_nodeids([ua.BrowsePath(kind, ua.RelativePath([step] * many))]),
            lambda: api.browse(ua.BrowseParameters(NodesToBrowse=[browse] * (MAX_OPERATIONS // 10))),
        )
        found = []
        for call in calls:
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await call()
            found.append(code(refused))
        await api.browse(ua.BrowseParameters(NodesToBrowse=[browse] * 10))
        return found

    assert asyncio.run(with_client(server, work)) == [int(ua.StatusCodes.BadTooManyOperations)] * 4


def test_a_client_reads_the_limits_and_no_value_is_large(server: OpcuaServer) -> None:
    space = server.served.server.iserver.aspace
    limits = "Server_ServerCapabilities_OperationLimits_"
    for name, expected in (("MaxMonitoredItemsPerCall", MAX_OPERATIONS), ("MaxNodesPerHistoryReadData", 20)):
        node = ua.NodeId(getattr(ua.ObjectIds, limits + name))
        assert space.read_attribute_value(node, ua.AttributeIds.Value).Value.Value == expected
    values = [space.read_attribute_value(node, ua.AttributeIds.Value) for node in space._nodes]
    assert max(len(struct_to_binary(one)) for one in values) < 4096


def test_a_filter_of_events_is_limited(server: OpcuaServer) -> None:
    """One that never ends would hold up everybody at the next event, or at once."""

    async def work(client: Client) -> list[int]:
        endless = ua.ContentFilterElement(ua.FilterOperator.Not, [ua.ElementOperand(0)])
        wanted = ua.EventFilter(WhereClause=ua.ContentFilter([endless]))
        own = await client.create_subscription(100, _Ignored())
        events = ua.ReadValueId(ua.NodeId(ua.ObjectIds.Server), ua.AttributeIds.EventNotifier)
        item = ua.MonitoredItemCreateRequest(events, RequestedParameters=ua.MonitoringParameters(Filter=wanted))
        every = ua.MonitoringParameters(Filter=ua.EventFilter())
        empty = ua.MonitoredItemCreateRequest(events, RequestedParameters=every)
        (made,) = await client.uaclient.create_monitored_items(
            ua.CreateMonitoredItemsParameters(own.subscription_id, ItemsToCreate=[empty])
        )
        change = ua.MonitoredItemModifyRequest(made.MonitoredItemId, ua.MonitoringParameters(Filter=wanted))
        history = ua.HistoryReadValueId(ua.NodeId(ua.ObjectIds.Server))
        api, number = client.uaclient, own.subscription_id
        calls: tuple[Any, ...] = (
            lambda: api.create_monitored_items(ua.CreateMonitoredItemsParameters(number, ItemsToCreate=[item])),
            lambda: api.modify_monitored_items(ua.ModifyMonitoredItemsParameters(number, ItemsToModify=[change])),
            lambda: client.nodes.server.history_read_events(ua.ReadEventDetails(Filter=wanted)),
            lambda: api.history_read(ua.HistoryReadParameters(ua.ReadEventDetails(), NodesToRead=[history] * 2)),
        )
        found = []
        for call in calls:
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await call()
            found.append(code(refused))
        return found

    codes = asyncio.run(with_client(server, work))
    invalid, many = int(ua.StatusCodes.BadContentFilterInvalid), int(ua.StatusCodes.BadTooManyOperations)
    assert codes == [invalid, invalid, invalid, many]


def test_a_deadband_keeps_no_change_from_a_client(server: OpcuaServer) -> None:
    """The library compares with the sample before, not with what it has reported, and fails where a value ends."""
    seen: asyncio.Queue[tuple[Any, bool]] = asyncio.Queue()

    class Seen:
        def datachange_notification(self, _: Any, value: Any, told: Any) -> None:
            seen.put_nowait((value, told.monitored_item.Value.StatusCode.is_good()))

    def show(reading: RangeReading) -> None:
        server.show(replace(good(reading.t_ns), range=reading))

    async def work(client: Client) -> list[tuple[Any, bool]]:
        now_ns = server.main.clock.now_ns()
        readings = [RangeReading(now_ns, Quality.GOOD, distance) for distance in (412.5, 410.0, 408.0, 414.0)]
        readings.insert(3, RangeReading(now_ns, Quality.TOO_FAR))
        await asyncio.to_thread(show, readings[0])
        own = await client.create_subscription(100, Seen())
        wanted = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Absolute, 5.0)
        distance = client.get_node("ns=2;s=bay1.distance_mm")
        await own._subscribe([distance], ua.AttributeIds.Value, mfilter=wanted)
        for reading in readings[1:]:
            await asyncio.to_thread(show, reading)
        return [await asyncio.wait_for(seen.get(), 10) for _ in readings]

    found = asyncio.run(with_client(server, work))
    assert found == [(412.5, True), (410.0, True), (408.0, True), (None, False), (414.0, True)]


def test_an_item_takes_only_filters_of_its_kind(server: OpcuaServer) -> None:
    """With another the next event would end the server, and the next value would be told to nobody."""

    async def work(client: Client) -> tuple[list[int], int]:
        own = await client.create_subscription(3_600_000, _Ignored())
        number = own.subscription_id
        kinds = ua.AttributeIds.EventNotifier, ua.AttributeIds.Value
        places = (ua.NodeId(ua.ObjectIds.Server), kinds[0]), (ua.NodeId("bay1.distance_mm", 2), kinds[1])
        filters = ua.EventFilter(), ua.DataChangeFilter(ua.DataChangeTrigger.Status), ua.AggregateFilter()
        found, items = [], []
        for place, own_filter in zip(places, filters, strict=False):
            for wanted in filters:
                asked = ua.MonitoringParameters(1, Filter=wanted)
                item = ua.MonitoredItemCreateRequest(ua.ReadValueId(*place), ua.MonitoringMode.Reporting, asked)
                create = ua.CreateMonitoredItemsParameters(number, ItemsToCreate=[item])
                if wanted is own_filter:
                    (made,) = await client.uaclient.create_monitored_items(create)
                    items.append(made.MonitoredItemId)
                    continue
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await client.uaclient.create_monitored_items(create)
                found.append(code(refused))
        for wanted in (*zip(items, filters[1::-1], strict=True), (99, None)):
            change = ua.MonitoredItemModifyRequest(wanted[0], ua.MonitoringParameters(1, Filter=wanted[1]))
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await client.uaclient.modify_monitored_items(ua.ModifyMonitoredItemsParameters(number, 0, [change]))
            found.append(code(refused))
        changes = [ua.MonitoredItemModifyRequest(one, ua.MonitoringParameters(1)) for one in items]  # no filter, queue
        await client.uaclient.modify_monitored_items(ua.ModifyMonitoredItemsParameters(number, 0, changes))
        await asyncio.to_thread(show_many, MAX_QUEUE + 10)
        queues = server.served.server.iserver.subscription_service.subscriptions[number]._triggered_datachanges
        return found, len(queues[items[1]])

    def show_many(count: int) -> None:
        alarm = Alarm("bay1.camera_down", "camera_down", "bay1", AlarmState.UNACKNOWLEDGED, active=True)
        server.main.links = SystemStatus(alarms=AlarmSummary((alarm,)))
        now_ns = server.main.clock.now_ns()
        for distance in range(count):
            server.show(replace(good(now_ns), range=RangeReading(now_ns, Quality.GOOD, 300.0 + distance)))

    codes, kept = asyncio.run(with_client(server, work))
    other, unknown = ua.StatusCodes.BadMonitoredItemFilterUnsupported, ua.StatusCodes.BadMonitoredItemIdInvalid
    assert codes == [int(other)] * 6 + [int(unknown)]
    assert kept == MAX_QUEUE


def test_nobody_registers_a_server_or_adds_nodes(server: OpcuaServer) -> None:
    async def work(client: Client) -> list[int]:
        found = []
        calls: tuple[Any, ...] = (
            lambda: client.uaclient.register_server(ua.RegisteredServer()),
            lambda: client.uaclient.add_nodes([ua.AddNodesItem()]),
        )
        for call in calls:
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await call()
            found.append(code(refused))
        return found

    refused = asyncio.run(with_client(server, work))
    assert refused == [int(ua.StatusCodes.BadServiceUnsupported), int(ua.StatusCodes.BadUserAccessDenied)]


def test_a_sessions_token_can_not_be_guessed(server: OpcuaServer) -> None:
    async def work(client: Client) -> set[bytes]:
        sessions: LimitedSessions = server.served.server.iserver
        assert sessions.now(4840).sessions == 1
        return {bytes(token.Identifier) for token in sessions._external_sessions}

    first, second = (asyncio.run(with_client(server, work)) for _ in range(2))
    assert [len(token) for token in (*first, *second)] == [32, 32]
    assert first != second


def test_a_certificate_without_proof_counts_for_nothing(tmp_path: Any) -> None:
    """The security policy None proves no possession of the key: an operator's certificate is public."""
    from asyncua.crypto.security_policies import SecurityPolicyNone
    from cryptography.hazmat.primitives.serialization import Encoding

    certificate = Plant(tmp_path).client("mes").public_bytes(Encoding.DER)
    made = Unproven(SecurityPolicyNone, ua.MessageSecurityMode.None_).create(certificate)
    assert not made.peer_certificate


def test_the_parts_that_are_overridden_are_there() -> None:
    """Of the pinned library; another version is looked at first (docs/decisions/0040-private-parts.md)."""
    for kind in (LimitedSession, LimitedSessions, LimitedConnection, Unproven):
        base = kind.__mro__[1]
        for name in vars(kind):
            if callable(getattr(kind, name)) and not name.startswith("__") and name not in OWN:
                assert hasattr(base, name), (kind, name)


OWN = {"_put", "_own", "_is_own", "end_refused", "now", "of", "pause_writing", "_abort"}


class _Ignored:
    def datachange_notification(self, *_: Any) -> None:
        """Nothing is done with it."""
