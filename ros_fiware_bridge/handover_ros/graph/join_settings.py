"""The settings with which an adapter joins a graph."""

from dataclasses import dataclass
from pathlib import Path

DEFAULT_MAX_MESSAGE_BYTES = 16 * 2**20


@dataclass(frozen=True, slots=True)
class JoinSettings:
    """The node and the network of the bridge.

    `interfaces` (names or addresses; default: the network that the machine prefers, and loopback), `peers`
    (addresses for unicast discovery, where multicast does not reach) and `multicast` apply to Cyclone DDS; an
    installed ROS has its own settings for these. `rosbridge_url` is the address of a rosbridge server.
    `max_message_bytes` is the size limit of messages in both directions. `goals_file` keeps what recognizes
    the goals of this node after a restart (see `own_goals`); without it, those of an earlier run are not
    cancelled.
    """

    node: str = "handover_bridge"
    namespace: str = "/"
    enclave: str = "/"
    domain_id: int = 0
    interfaces: tuple[str, ...] = ()
    peers: tuple[str, ...] = ()
    multicast: bool = True
    max_message_bytes: int = DEFAULT_MAX_MESSAGE_BYTES
    rosbridge_url: str = "ws://127.0.0.1:9090"
    goals_file: Path | None = None
