"""What the broker has answered to the messages of each topic, and when one that it did not take is tried again. Pure.

A topic is held after a message that the broker refused or passed on to nobody: nothing of it is sent until it is tried
again, with one message, 1 s later, then after twice as long, at the latest after 30 s, and on a new connection at once.
One after which the broker ends the connection, which MQTT 3.1.1 gives no reason for, is tried again after 1 to 10
minutes.
"""

from collections.abc import Set
from dataclasses import dataclass

from gateway.core import details
from gateway.durations import NS_PER_S

RETRY_S = 1.0, 30.0  # the first wait, and the longest
CUT_RETRY_S = 60.0, 600.0
CUTS = 4  # connections in a row that ended after this message, with nothing else on its way
NAMED = 3  # topics in a text for people


@dataclass(slots=True)
class TopicAnswer:
    """Times: monotonic ns."""

    taken: bool = False  # the newest message of this connection was
    fault: str = ""  # why the broker refuses it
    unsubscribed: bool = False  # nobody subscribes to it
    used: bool = False  # somebody did, since the start, and not too long ago
    since_ns: int = 0  # of `fault`, or of `unsubscribed`
    wait_s: float = 0.0
    until_ns: int = 0  # nothing of it is sent until then
    cuts: int = 0

    @property
    def cuts_connections(self) -> bool:
        return self.cuts >= CUTS


class TopicAnswers:
    """Of all topics that something was sent to; a topic is known by its name. Times: monotonic ns."""

    def __init__(self) -> None:
        self._topics: dict[str, TopicAnswer] = {}
        self._not_delivered: dict[str, TopicAnswer] = {}  # those of `_topics` that are refused, or have no subscriber

    def connected(self) -> None:
        """A new connection: what was held may be tried at once, unless it would end this one, too."""
        for answer in self._topics.values():
            answer.taken = False
            if not answer.cuts_connections:
                answer.wait_s, answer.until_ns = 0.0, 0

    def taken(self, topic: str) -> None:
        """The broker has taken a message, and has passed it on to somebody as far as it tells."""
        old = self._topics.get(topic)
        self._topics[topic] = TopicAnswer(taken=True, used=True)
        self._not_delivered.pop(topic, None)
        if old is not None and old.unsubscribed:  # a subscription to many topics is likely
            for answer in self._not_delivered.values():
                if answer.unsubscribed:
                    answer.wait_s, answer.until_ns = 0.0, 0

    def passed_to_nobody(self, topic: str, now_ns: int) -> None:
        self._hold(topic, now_ns, RETRY_S, unsubscribed=True)

    def refused(self, topic: str, fault: str, now_ns: int) -> None:
        self._hold(topic, now_ns, RETRY_S, fault=fault)

    def cut(self, topic: str, fault: str, now_ns: int, *, certain: bool = False) -> None:
        """The connection ended after a message of this topic, with nothing else on its way, or not for the first
        time. `certain`: after the broker had refused that message."""
        answer = self._topics.setdefault(topic, TopicAnswer())
        answer.cuts = max(CUTS, answer.cuts) if certain else answer.cuts + 1
        if certain:
            answer.until_ns = 0  # by the refusal itself it was held for less
        if answer.cuts_connections:
            self._hold(topic, now_ns, CUT_RETRY_S, fault=fault)

    def unused(self, topic: str) -> None:
        """Nobody has subscribed to it for so long that nobody is expected to."""
        self._topics[topic].used = False

    def pipelined(self, topic: str) -> bool:
        """More than one message may be on its way: the newest answer on this connection was a good one."""
        return topic in self._topics and self._topics[topic].taken

    def held(self, now_ns: int) -> Set[str]:
        """What must not be sent now."""
        return {topic for topic, answer in self._not_delivered.items() if answer.until_ns > now_ns}

    def until_ns(self, topic: str) -> int:
        return self._topics[topic].until_ns

    def is_used(self, topic: str) -> bool:
        return topic in self._topics and self._topics[topic].used

    def unsubscribed_ns(self, topic: str, now_ns: int) -> int:
        """For how long nobody has subscribed to it."""
        answer = self._topics.get(topic)
        return now_ns - answer.since_ns if answer is not None and answer.unsubscribed else 0

    def cuts_connections(self, topic: str) -> bool:
        return topic in self._topics and self._topics[topic].cuts_connections

    @property
    def not_delivered(self) -> list[str]:
        """Topics that are refused, or that nobody subscribes to, whether they are tried just now or not."""
        return list(self._not_delivered)

    @property
    def alarms(self) -> dict[str, str]:
        """As in LinkStatus: what is refused, and why; and topics without a subscriber that had one."""
        held = self._not_delivered.items()
        found = {
            "messages_refused": _listed([details.TOPIC_REFUSED(topic, one.fault) for topic, one in held if one.fault]),
            "events_unsubscribed": _listed([topic for topic, answer in held if answer.unsubscribed and answer.used]),
        }
        return {alarm: detail for alarm, detail in found.items() if detail}

    def _hold(
        self, topic: str, now_ns: int, retry_s: tuple[float, float], *, fault: str = "", unsubscribed: bool = False
    ) -> None:
        answer = self._topics.setdefault(topic, TopicAnswer())
        if (bool(answer.fault), answer.unsubscribed) != (bool(fault), unsubscribed):
            answer.since_ns = now_ns
        answer.taken, answer.fault, answer.unsubscribed = False, fault, unsubscribed
        self._not_delivered[topic] = answer
        if answer.until_ns <= now_ns:  # else this was on its way with the one that it is held for
            first_s, longest_s = retry_s
            answer.wait_s = min(longest_s, max(first_s, 2 * answer.wait_s))
            answer.until_ns = now_ns + round(answer.wait_s * NS_PER_S)


def _listed(found: list[str]) -> str:
    text = "; ".join(found[:NAMED])
    return details.AND_MORE(text, len(found) - NAMED) if len(found) > NAMED else text
