"""The library's server with the limits that it lacks against clients that are wrong, slow or hostile. IO.

Overridden parts are no interface of the library, which is pinned: docs/decisions/0040-private-parts.md.

- A session's token can't be guessed; a session changes only its own subscriptions, and takes over none.
- Connections, sessions, subscriptions, monitored items, the bytes of a request, those not yet sent, and the operations
  of a request are limited; a connection without an activated session is closed.
- A deadband is left out, and a change of value always told: with the library's, a client keeps an old value.
- A message that breaks the protocol ends its connection; no client may register a server.
"""

import asyncio
import secrets
import socket
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import replace
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession, SessionState
from asyncua.server.user_managers import UserManager

from gateway.config import OpcuaConfig
from gateway.opcua import decoding
from gateway.opcua.access import ClientAccess, OpcuaCaller
from gateway.opcua.sent_event import check_filter
from gateway.web.ipc.messages import OpcuaNow

MIN_PUBLISHING_MS, MAX_PUBLISHING_MS = 100.0, 3_600_000.0
MAX_SUBSCRIPTIONS = 64  # of all sessions
SESSION_DEADLINE_S = 10.0  # a connection without an activated session for this time is closed
MAX_REQUEST_BYTES = 256 * 1024
MAX_FIRST_BYTES = 16 * 1024  # of a request before its session is activated
MAX_OPERATIONS = 1000  # of one request
MAX_REFERENCES = 5000  # of the nodes that one request browses
MAX_HISTORIES = 20  # of one request
MAX_UNSENT = 4 * 1024 * 1024
MAX_QUEUE = 100  # notifications that one monitored item keeps
CHUNK_BYTES = 65_536
CHUNK_HEADER_BYTES = 12  # with the channel's number
PENDING_CHUNKS = 50

REFRESHES = [
    ua.NodeId(one)
    for one in (ua.ObjectIds.ConditionType_ConditionRefresh, ua.ObjectIds.ConditionType_ConditionRefresh2)
]

CALLER: ContextVar[OpcuaCaller] = ContextVar("caller")
"""Who has called the method that runs now."""


class KnownUser(User):  # type: ignore[misc]
    def __init__(self, caller: OpcuaCaller, certificate: bytes | None) -> None:
        super().__init__(UserRole.User, caller.subject)
        self.caller, self.certificate = caller, certificate


class Users(UserManager):  # type: ignore[misc]  # the library's types are not used
    """A user is the application's certificate."""

    def __init__(self, access: ClientAccess) -> None:
        self._access = access

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        caller = self._access.of(certificate)
        if caller is None:
            iserver.certificates_refused += 1
        return None if caller is None else KnownUser(caller, certificate)


class LimitedSession(InternalSession):  # type: ignore[misc]
    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        if self.external:
            self.iserver.unregister_external_session(self)
            self.auth_token = ua.NodeId(secrets.token_bytes(32))
            self.iserver.register_external_session(self)

    def activate_session(self, params: Any, peer_certificate: Any) -> Any:
        """Not once it has made room: nobody would end it when its certificate does."""
        if self.iserver.lookup_external_session(self.auth_token) is not self:
            raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
        return super().activate_session(params, peer_certificate)

    async def read(self, params: Any) -> Any:
        _few(params.NodesToRead)
        return await super().read(params)

    async def browse(self, params: Any) -> Any:
        _few(params.NodesToBrowse)
        known = [self.aspace.get(one.NodeId) for one in params.NodesToBrowse]
        if sum(len(node.references) for node in known if node is not None) > MAX_REFERENCES:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        return await super().browse(params)

    async def translate_browsepaths_to_nodeids(self, params: Any) -> Any:
        _few([part for path in params for part in path.RelativePath.Elements])
        return await super().translate_browsepaths_to_nodeids(params)

    async def write(self, params: Any) -> Any:
        _few(params.NodesToWrite)
        return await super().write(params)

    async def history_read(self, params: Any) -> Any:
        events = isinstance(params.HistoryReadDetails, ua.ReadEventDetails)  # only Server has some
        _few(params.NodesToRead, 1 if events else MAX_HISTORIES)
        return await super().history_read(params)

    async def call(self, params: Any) -> Any:
        _few(params, MAX_HISTORIES)
        for one in params:
            if one.MethodId in REFRESHES:  # another's queue would be filled with it, and lose what is new
                self._own(one.InputArguments[0].Value if one.InputArguments else 0)
        if isinstance(self.user, KnownUser):
            CALLER.set(replace(self.user.caller, address=str(self.name[0])))
        return await super().call(params)

    async def create_subscription(self, params: Any, callback: Any, request_callback: Any = None) -> Any:
        params.RequestedPublishingInterval = max(
            MIN_PUBLISHING_MS, min(MAX_PUBLISHING_MS, params.RequestedPublishingInterval)
        )
        return await super().create_subscription(params, callback, request_callback)

    async def create_monitored_items(self, params: Any) -> Any:
        self._own(params.SubscriptionId)
        _few(params.ItemsToCreate)
        for item in params.ItemsToCreate:
            _limit_filter(item.RequestedParameters, item.ItemToMonitor.AttributeId == ua.AttributeIds.EventNotifier)
        others = self.subscription_service.subscriptions.values()
        if sum(len(one.monitored_item_srv._monitored_items) for one in others) + len(params.ItemsToCreate) > (
            self.iserver.max_monitored_items
        ):
            raise ServiceError(ua.StatusCodes.BadTooManyMonitoredItems)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(self, params: Any) -> Any:
        self._own(params.SubscriptionId)
        _few(params.ItemsToModify)
        items = self.subscription_service.subscriptions[params.SubscriptionId].monitored_item_srv._monitored_items
        for item in params.ItemsToModify:
            if (known := items.get(item.MonitoredItemId)) is None:
                raise ServiceError(ua.StatusCodes.BadMonitoredItemIdInvalid)
            asked = item.RequestedParameters
            _limit_filter(asked, known.where_clause_evaluator is not None)
            asked.QueueSize = min(asked.QueueSize or MAX_QUEUE, MAX_QUEUE)  # 0 would be without a limit
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: Any) -> Any:
        self._own(params.SubscriptionId)
        _few(params.MonitoredItemIds)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: Any) -> Any:
        self._own(params.SubscriptionId)
        _few(params.MonitoredItemIds)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: Any) -> Any:
        for one in params.SubscriptionIds:
            self._own(one)
        return await super().set_publishing_mode(params)

    def modify_subscription(self, params: Any) -> Any:
        self._own(params.SubscriptionId)
        return super().modify_subscription(params)

    def republish(self, params: Any) -> Any:
        """As often as it is asked for. What is gone is said to be: a client then reads anew."""
        self._own(params.SubscriptionId)
        sent = self.subscription_service.subscriptions[params.SubscriptionId]._not_acknowledged_results
        if (found := sent.get(params.RetransmitSequenceNumber)) is None:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return found.NotificationMessage

    async def close_session(self, delete_subs: bool = True) -> None:
        """With its subscriptions, which nobody could take over: they would keep their places for months."""
        await super().close_session(True)

    async def delete_subscriptions(self, ids: Sequence[int]) -> Any:
        for one in ids:
            self._own(one)
        return await super().delete_subscriptions(list(ids))

    def publish(self, acks: Any = None) -> Any:
        return super().publish([ack for ack in acks or () if self._is_own(ack.SubscriptionId)])

    async def transfer_subscriptions(self, params: Any, callback: Any) -> Any:
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def _is_own(self, subscription: int) -> bool:
        found = self.subscription_service.subscriptions.get(subscription)
        return found is not None and found.session_id == self.session_id

    def _own(self, subscription: int) -> None:
        if not self._is_own(subscription):
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)


def _few(operations: Sequence[Any] | None, most: int = MAX_OPERATIONS) -> None:
    if len(operations or ()) > most:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)


def _limit_filter(asked: Any, events: bool) -> None:
    """An item of another kind than its filter ends the server at the next event, or is told of no change. Kinds by what
    they hold: the library has two classes DataChangeFilter, and `ua` names the other."""
    wanted = asked.Filter
    if events and hasattr(wanted, "SelectClauses"):
        check_filter(wanted)
    elif not events and hasattr(wanted, "DeadbandType"):
        wanted.DeadbandType = ua.DeadbandType.None_  # the library's keeps back slow changes, and ends of values
        wanted.Trigger = max(wanted.Trigger, ua.DataChangeTrigger.StatusValue)
    elif wanted is None or wanted == ua.ExtensionObject():
        asked.Filter = None  # as it is
    else:
        raise ServiceError(ua.StatusCodes.BadMonitoredItemFilterUnsupported)


class LimitedSessions(InternalServer):  # type: ignore[misc]
    def __init__(self, config: OpcuaConfig, access: ClientAccess) -> None:
        super().__init__(Users(access))
        self._access = access
        self.allow_remote_admin = False
        self.bind_condition_methods = 1
        self.supported_tokens = (ua.AnonymousIdentityToken,)  # its certificate says who it is
        self.max_sessions = self.max_connections = config.max_connections
        self.max_subscriptions = MAX_SUBSCRIPTIONS
        self.max_monitored_items = config.max_monitored_items
        self.max_pending_activation_seconds = SESSION_DEADLINE_S
        self.max_pending_messages_per_connection = PENDING_CHUNKS
        self.max_monitored_item_queue_size = self.max_unacked_messages_per_subscription = MAX_QUEUE
        self.certificates_refused = self.over_limit = self.protocol_faults = 0
        self.max_lifetime_count, self.max_keep_alive_count = 3000, 1000

    def create_session(self, name: Any, user: Any = None, external: bool = False) -> InternalSession:
        """Sessions that nobody has activated in time make room first."""
        old = asyncio.get_running_loop().time() - self.max_pending_activation_seconds
        for one in list(self._external_sessions.values()):
            if one.state is SessionState.Created and one._last_activity < old:
                self.unregister_external_session(one)
        if len(self._external_sessions) >= self.max_sessions:
            self.over_limit += 1
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        return LimitedSession(self, self.aspace, self.subscription_service, name, user=User(), external=external)

    async def setup_nodes(self) -> None:
        """The limits as clients read them. Schemas of the standard, 550 kB, would be asked for a thousand times."""
        await super().setup_nodes()
        for name, limit in {
            "MaxNodesPerRead": MAX_OPERATIONS,
            "MaxNodesPerWrite": MAX_OPERATIONS,
            "MaxNodesPerBrowse": MAX_OPERATIONS,
            "MaxNodesPerTranslateBrowsePathsToNodeIds": MAX_OPERATIONS,
            "MaxMonitoredItemsPerCall": MAX_OPERATIONS,
            "MaxNodesPerHistoryReadData": MAX_HISTORIES,
            "MaxNodesPerHistoryReadEvents": 1,
            "MaxNodesPerMethodCall": MAX_HISTORIES,
        }.items():
            node = getattr(ua.ObjectIds, f"Server_ServerCapabilities_OperationLimits_{name}")
            self._put(node, ua.DataValue(ua.Variant(limit, ua.VariantType.UInt32)))
        for schema in (ua.ObjectIds.OpcUa_BinarySchema, ua.ObjectIds.OpcUa_XmlSchema):
            self._put(schema, ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadNotReadable)))

    def _put(self, node: int, value: Any) -> None:
        self.aspace[ua.NodeId(node)].attributes[ua.AttributeIds.Value].value = value

    def register_server(self, server: Any, conf: Any = None) -> None:
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def now(self, port: int) -> OpcuaNow:
        active = sum(one.is_activated() for one in self._external_sessions.values())
        return OpcuaNow(port, active, self.certificates_refused, self.over_limit, self.protocol_faults)

    async def end_refused(self) -> None:
        """Sessions whose certificate has expired meanwhile."""
        for one in list(self._external_sessions.values()):
            if isinstance(one.user, KnownUser) and self._access.of(one.user.certificate) is None:
                await one.close_session(True)


class LimitedConnection(OPCUAProtocol):  # type: ignore[misc]
    def connection_made(self, transport: Any) -> None:
        transport.set_write_buffer_limits(high=MAX_UNSENT)
        super().connection_made(transport)
        self.iserver.over_limit += self.transport is None

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        short = len(self._buffer) >= 8 and int.from_bytes(self._buffer[4:8], "little") < CHUNK_HEADER_BYTES
        if short or len(self._buffer) > CHUNK_BYTES or (self.transport is not None and self.transport.is_closing()):
            self._abort()

    def pause_writing(self) -> None:
        self._abort()  # it does not read what it has asked for

    async def _process_one_msg(self, header: Any, buf: Any) -> bool:
        await asyncio.sleep(0)  # values and other clients have their turn between the messages of one
        session, parts = self.processor.session, self.processor._connection._incoming_size
        if parts + header.body_size > MAX_FIRST_BYTES and not (session is not None and session.is_activated()):
            self._abort()
            return False
        watchdog = self.processor._session_watchdog_task
        try:
            goes_on = bool(await super()._process_one_msg(header, buf))
            if session is not None and self.processor.session is not session:  # one at a time: the former one's place
                watchdog.cancel()
                await session.close_session()
            return goes_on
        except Exception:  # noqa: BLE001 - whatever bytes can cause
            self._abort()
            return False

    def _abort(self) -> None:
        if self.transport is not None:
            self.iserver.protocol_faults += 1
            self.transport.abort()


class LimitedListener(BinaryServer):  # type: ignore[misc]
    def __init__(self, sessions: LimitedSessions, sockets: Sequence[socket.socket], limits: TransportLimits) -> None:
        super().__init__(sessions, "", 0, limits)
        self._sockets = sockets

    def _make_protocol(self) -> OPCUAProtocol:
        return LimitedConnection(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._servers = [await loop.create_server(self._make_protocol, sock=sock) for sock in self._sockets]
        self.cleanup_task = loop.create_task(self._close_task_loop())


class Unproven(SecurityPolicyFactory):  # type: ignore[misc]
    """Without security anybody can send anybody's certificate: it counts for nothing."""

    @classmethod
    def of(cls, one: Any) -> "Unproven":
        return cls(one.cls, one.mode, one.certificate, one.private_key, one.permission_ruleset)

    def create(self, peer_certificate: bytes | None) -> Any:
        return super().create(None)


class HardenedServer(Server):  # type: ignore[misc]
    """Serves on sockets that listen already. `sessions` knows who may connect."""

    def __init__(self, sessions: LimitedSessions, sockets: Sequence[socket.socket]) -> None:
        super().__init__(sessions)
        self._sockets = sockets
        decoding.limit()
        self.limits = decoding.ClientLimits(CHUNK_BYTES, CHUNK_BYTES, MAX_REQUEST_BYTES // 8192, MAX_REQUEST_BYTES)

    async def start(self) -> None:
        await self._setup_server_nodes()
        policies = [Unproven.of(one) if one.cls is SecurityPolicyNone else one for one in self._policies]
        for token in [token for endpoint in self.iserver.endpoints for token in endpoint.UserIdentityTokens]:
            token.SecurityPolicyUri = None  # the endpoint's own: some clients find no way to use another
        await self.iserver.start()
        assert isinstance(self.iserver, LimitedSessions)
        listener = self.bserver = LimitedListener(self.iserver, self._sockets, self.limits)
        listener.set_policies(policies)
        await listener.start()
