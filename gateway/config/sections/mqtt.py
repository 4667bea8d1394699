"""`[mqtt]`: the broker, the outbox and the profiles. Pure."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gateway.config.sections.common import ClientTls, Reconnect
from gateway.config.strict import forms
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section

BrokerUrl = Annotated[str, Field(pattern=forms.BROKER_URL)]
Level = Annotated[str, Field(pattern=forms.TOPIC_LEVEL)]


class SparkplugConfig(Section):
    """The gateway as a Sparkplug B 3.0 edge node, on a separate connection beside that of the plain topics."""

    group_id: str | None = Field(
        None, pattern=forms.SPARKPLUG_ID, description="first level after the namespace; default: `site`"
    )
    edge_node_id: str | None = Field(
        None, pattern=forms.SPARKPLUG_ID, description="unique in its group; default: `instance`"
    )
    primary_host_id: str | None = Field(
        None, pattern=forms.SPARKPLUG_ID, description="births wait until this host is online; absent: for none"
    )
    period_s: float = Field(0.5, ge=0.05, le=60, description="data at most so often; changes of stop at once")
    datatypes_in_data: bool = Field(
        True, description="DDATA carry datatypes, as births do; false: smaller, but many decoders need them"
    )
    history: int = Field(
        1000, ge=0, le=100_000, description="changes of stop, and visits, kept until a host has certainly received them"
    )


class MqttTls(ClientTls):
    """With `url = "mqtts://..."`. Absent: the system's certificate authorities, and no certificate of our own."""


class MqttConfig(Section):
    url: BrokerUrl | None = Field(
        None,
        description="the broker: mqtt[s]://[user[:password]@]host[:port], or over a WebSocket "
        "ws[s]://[user[:password]@]host[:port][/path]; every address of the host is tried",
    )
    urls: tuple[BrokerUrl, ...] = Field(
        (), max_length=16, description="instead of `url`: several brokers, the preferred one first"
    )
    urls_shuffled: bool = Field(
        False, description="each gateway prefers the brokers of `urls` in an order of its own, so that they share them"
    )
    return_s: float = Field(
        60.0,
        ge=0.1,
        le=86_400,
        description="while a broker other than the first of `urls` is connected: how often those before it are checked",
    )
    root: str = Field("loading", pattern=forms.TOPIC_ROOT, description="first level of every topic")
    area: Level | None = Field(None, description="topic level after the site (ISA-95); default: none")
    line: Level | None = Field(None, description="topic level after the area, or the site; default: none")
    client_id: str | None = Field(None, max_length=64, description="default: gateway-<site>-<instance>")
    username: str | None = Field(None, min_length=1, max_length=1000, description="instead of one in the url")
    password_file: str | None = Field(None, min_length=1, description="file whose one line is the password")
    password_env: str | None = Field(
        None, pattern=forms.VARIABLE, description="environment variable that holds the password"
    )
    proxy: str | None = Field(
        None, pattern=forms.PROXY_URL, description="HTTP proxy that connects to the broker (CONNECT): http://host:port"
    )
    proxy_username: str | None = Field(None, min_length=1, max_length=1000, description="user at the proxy")
    proxy_password_file: str | None = Field(None, min_length=1, description="file whose one line is the password there")
    proxy_password_env: str | None = Field(
        None, pattern=forms.VARIABLE, description="environment variable that holds the password there"
    )
    protocol: Literal["auto", "5", "3.1.1"] = Field("auto", description="auto: MQTT 5, and 3.1.1 where 5 is refused")
    event_expiry_h: float = Field(
        168.0, ge=0.01, le=87600, description="MQTT 5: the broker drops an event not fetched for this time"
    )
    events_in_flight: int = Field(
        48,
        ge=1,
        le=48,
        description="events on their way at once; 1: in order also where a broker loses one on its way, and slower",
    )
    unsubscribed_h: float = Field(
        24.0,
        ge=0,
        le=87600,
        description="MQTT 5: an event that nobody had subscribed to is kept, and sent again, for this time; 0: it "
        "counts as delivered",
    )
    plain_topics: bool = Field(
        True, description="publish the JSON topics of docs/mqtt.md; false: Sparkplug alone, which must be configured"
    )
    home_assistant: bool = Field(False, description="every bay appears in Home Assistant by itself (MQTT discovery)")
    home_assistant_prefix: str = Field(
        "homeassistant", pattern=forms.TOPIC_PREFIX, description="discovery prefix, as set in Home Assistant"
    )
    sparkplug: SparkplugConfig | None = Field(None, description="absent: no Sparkplug")
    tls: MqttTls | None = Field(None, description="certificates for mqtts://")
    values: bool = Field(
        False, description="each value of a bay also on a topic of its own, <bay>/value/..., for unified namespaces"
    )
    values_period_s: float = Field(
        5.0, ge=0.5, le=3600, description="changed values are published at once, all of them this often"
    )
    state_period_s: float = Field(
        0.5, ge=0.02, le=60, description="retained state at most so often; changes of stop at once"
    )
    keepalive_s: int = Field(10, ge=2, le=3600, description="the broker sends the last will after 1.5 of these")
    outbox_events: int = Field(10_000, ge=10, le=200_000, description="events kept while the broker is away")
    outbox_mb: int = Field(64, ge=1, le=1000, description="room for them, MB")
    outbox_days: float = Field(30.0, ge=0.01, le=3650, description="an older event is dropped")
    outbox_file: str = Field(
        "auto",
        description="SQLite file that keeps them through a restart or a power cut; auto: "
        "outbox-<site>-<instance>.sqlite in /var/lib/loading-gateway, or in ~/.local/state/loading-gateway for other "
        "users than root; empty: memory only",
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)

    @property
    def brokers(self) -> tuple[str, ...]:
        """The URLs of all brokers, the preferred one first."""
        return self.urls if self.url is None else (self.url,)

    @model_validator(mode="after")
    def _url_or_urls(self) -> Self:
        if not self.brokers:
            raise FieldError("is missing; or urls, a list of several brokers", "url")
        if self.url is not None and self.urls:
            raise FieldError("url is given, too; keep one of them", "urls")
        return self

    @model_validator(mode="after")
    def _one_password(self) -> Self:
        if self.password_file is not None and self.password_env is not None:
            raise FieldError("password_file is given, too; keep one of them", "password_env")
        if self.proxy_password_file is not None and self.proxy_password_env is not None:
            raise FieldError("proxy_password_file is given, too; keep one of them", "proxy_password_env")
        return self

    @model_validator(mode="after")
    def _something_published(self) -> Self:
        if not self.plain_topics and self.sparkplug is None:
            raise FieldError("false, and there is no [mqtt.sparkplug]: nothing would be published", "plain_topics")
        if not self.plain_topics and self.home_assistant:
            raise FieldError("reads the plain topics, and plain_topics is false", "home_assistant")
        return self
