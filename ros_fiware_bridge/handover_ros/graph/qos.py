"""Quality of service of topics, with the names of ROS 2."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType

from handover_ros.errors import UnknownQos


class Reliability(StrEnum):
    """Whether lost messages are sent again."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(StrEnum):
    """Whether a late reader receives earlier messages."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(StrEnum):
    """Whether the last `depth` messages are kept, or all."""

    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"


@dataclass(frozen=True, slots=True)
class Qos:
    """A quality of service; `depth` is a number of messages, used with `keep_last`."""

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10

    def __post_init__(self) -> None:
        if self.depth < 1:
            raise UnknownQos(f"a depth of {self.depth} keeps nothing; set a depth of 1 or more")

    @classmethod
    def named(cls, name: str) -> "Qos":
        """Return the profile called `name` (`default`, `sensor_data`, `services`, `latched`).

        Raises:
            UnknownQos: there is no such profile.
        """
        try:
            return PROFILES[name]
        except KeyError:
            names = ", ".join(PROFILES)
            raise UnknownQos(f'there is no quality of service "{name}"; it is one of {names}') from None

    def matching(self, offered: "Iterable[Qos]") -> "Qos":
        """Return this QoS with the reliability and durability that all `offered` writers can provide.

        Without a writer it is unchanged.
        """
        publishers = list(offered)
        if not publishers:
            return self
        reliable = all(publisher.reliability is Reliability.RELIABLE for publisher in publishers)
        late = all(publisher.durability is Durability.TRANSIENT_LOCAL for publisher in publishers)
        return replace(
            self,
            reliability=Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
            durability=Durability.TRANSIENT_LOCAL if late else Durability.VOLATILE,
        )

    def unmet(self, offered: "Qos") -> str | None:
        """Return why a writer that offers `offered` does not serve a reader with this QoS; None if it does.

        The request-versus-offered rules of the DDS specification (1.4, 2.2.3).
        """
        reasons = []
        if self.reliability is Reliability.RELIABLE and offered.reliability is Reliability.BEST_EFFORT:
            reasons.append("the reader wants reliable, the writer offers best_effort")
        if self.durability is Durability.TRANSIENT_LOCAL and offered.durability is Durability.VOLATILE:
            reasons.append("the reader wants transient_local, the writer offers volatile")
        return " and ".join(reasons) or None

    def __str__(self) -> str:
        kept = f"keep_last {self.depth}" if self.history is History.KEEP_LAST else "keep_all"
        return f"{self.reliability.value}, {self.durability.value}, {kept}"


DEFAULT = Qos()
SENSOR_DATA = Qos(reliability=Reliability.BEST_EFFORT, depth=5)
SERVICES = Qos(depth=10)
MAX_REQUESTS_IN_FLIGHT = 8
"""The maximum number of unanswered requests to one service. A ROS server keeps the last ten requests that it
has not processed, and drops the oldest silently.
"""
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)

PROFILES: Mapping[str, Qos] = MappingProxyType(
    {"default": DEFAULT, "sensor_data": SENSOR_DATA, "services": SERVICES, "latched": LATCHED}
)
