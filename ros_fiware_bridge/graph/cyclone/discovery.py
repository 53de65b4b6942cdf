"""Discovery: who is on the graph, as DDS and the nodes themselves tell it.

DDS tells of participants and their endpoints; each participant publishes on `ros_discovery_info` which of its
endpoints belong to which node. Kept by the listening thread, read by the loop.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import structlog

from ros_fiware_bridge.errors import BadMessage
from ros_fiware_bridge.graph.cyclone import dds_names, dds_qos
from ros_fiware_bridge.graph.cyclone.samples import Sample
from ros_fiware_bridge.graph.qos import Qos
from ros_fiware_bridge.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_AT_ONCE = 100
_ALIVE = 16


@dataclass(frozen=True, slots=True)
class Known:
    """An endpoint of the graph; `guid` and `participant` are 16 bytes."""

    handle: int
    guid: bytes
    participant: bytes
    writes: bool
    topic: str
    """As DDS names it, `rt/joint_states`."""
    dds_type: str
    qos: Qos
    told: dict[str, str]

    @property
    def vendor(self) -> str:
        """The middleware it is made of."""
        return dds_names.vendor(self.participant)

    @property
    def type_hash(self) -> str | None:
        """`RIHS01_…`, if it tells."""
        return self.told.get("typehash")


def handles(matched: list[int]) -> set[int]:
    """Return handles as `Known` has them; of matches the binding gives them with a sign."""
    return {one % 2**64 for one in matched}


@dataclass(frozen=True, slots=True)
class KnownNode:
    """A node, and the GUIDs of its endpoints."""

    name: str
    namespace: str
    participant: bytes
    enclave: str
    guids: frozenset[bytes]

    @property
    def full_name(self) -> str:
        """The name with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True, slots=True)
class Picture:
    """The graph at one moment."""

    own: bytes
    endpoints: tuple[Known, ...] = ()
    nodes: tuple[KnownNode, ...] = ()
    _node_of: dict[bytes, str] = field(default_factory=dict)

    def node_of(self, endpoint: Known) -> str | None:
        """Return the full name of the node that an endpoint belongs to, if it is told."""
        return self._node_of.get(endpoint.guid)

    def at(self, topic: str, *, writes: bool) -> list[Known]:
        """Return the writers or readers of a DDS topic."""
        return [one for one in self.endpoints if one.topic == topic and one.writes is writes]


class Discovery:
    """Keeps the picture of the graph up to date."""

    def __init__(self, participant: Any, store: TypeStore) -> None:
        from cyclonedds.builtin import (  # noqa: PLC0415 - heavy
            BuiltinDataReader,
            BuiltinTopicDcpsParticipant,
            BuiltinTopicDcpsPublication,
            BuiltinTopicDcpsSubscription,
        )

        self.own: bytes = participant.get_guid().bytes
        self._store = store
        self._lock = threading.Lock()
        self._enclaves: dict[bytes, str] = {}
        self._endpoints: dict[bytes, Known] = {}
        self._writers: dict[int, Known] = {}
        self._nodes: dict[bytes, tuple[KnownNode, ...]] = {}
        self._picture: Picture | None = None
        self.readers: list[tuple[Any, Callable[[], None]]] = []
        for topic, seen in (
            (BuiltinTopicDcpsParticipant, self._participant),
            (BuiltinTopicDcpsPublication, lambda sample: self._endpoint(sample, True)),
            (BuiltinTopicDcpsSubscription, lambda sample: self._endpoint(sample, False)),
        ):
            reader = BuiltinDataReader(participant, topic)
            self.readers.append((reader, self._taking(reader, seen)))

    def _taking(self, reader: Any, seen: Callable[[Any], None]) -> Callable[[], None]:
        def take() -> None:
            while samples := reader.take(N=_AT_ONCE):
                with self._lock:
                    self._picture = None
                    for sample in samples:
                        try:
                            seen(sample)
                        except Exception:  # one odd peer must not hide the others
                            log.exception("a peer on the ROS graph cannot be understood")

        return take

    def look(self) -> None:
        """Take what DDS has to tell at once; in the listening thread only."""
        for _, take in self.readers:
            take()

    def _participant(self, sample: Any) -> None:
        key = sample.key.bytes
        if sample.sample_info.valid_data and sample.sample_info.instance_state == _ALIVE:
            self._enclaves[key] = dds_names.told(dds_qos.told(sample.qos)).get("enclave", "/")
        else:
            self._enclaves.pop(key, None)
            self._nodes.pop(key, None)

    def _endpoint(self, sample: Any, writes: bool) -> None:
        key, info = sample.key.bytes, sample.sample_info
        if not (info.valid_data and info.instance_state == _ALIVE):
            gone = self._endpoints.pop(key, None)
            if gone is not None:
                self._writers.pop(gone.handle, None)
            return
        known = Known(
            info.instance_handle,
            key,
            sample.participant_key.bytes,
            writes,
            sample.topic_name,
            sample.type_name,
            dds_qos.offered(sample.qos),
            dds_names.told(dds_qos.told(sample.qos)),
        )
        self._endpoints[key] = known
        if writes:
            self._writers[known.handle] = known

    def on_node_info(self, samples: list[Sample]) -> None:
        """Take what participants tell about their nodes."""
        for sample in samples:
            if sample.data is None:
                continue
            try:
                told = self._store.decode(dds_names.DISCOVERY_TYPE, sample.data)
            except BadMessage:
                continue  # nodes of a ROS release that describes itself in another way stay nameless
            participant = told["gid"]["data"]
            with self._lock:
                enclave = self._enclaves.get(participant, "/")
                self._picture = None
                self._nodes[participant] = tuple(
                    KnownNode(
                        one["node_name"],
                        one["node_namespace"],
                        participant,
                        enclave,
                        frozenset(gid["data"] for gid in (*one["reader_gid_seq"], *one["writer_gid_seq"])),
                    )
                    for one in told["node_entities_info_seq"]
                )

    def writer(self, handle: int) -> Known | None:
        """Return the writer of that instance handle, if it is known."""
        with self._lock:
            return self._writers.get(handle)

    def picture(self) -> Picture:
        """Return the graph as it is now known."""
        with self._lock:
            if self._picture is None:
                # What a node tells may outlive its participant in the topic that tells it.
                nodes = tuple(
                    one for key, told in self._nodes.items() if key in self._enclaves for one in told
                )
                owners = {guid: one.full_name for one in nodes for guid in one.guids}
                self._picture = Picture(self.own, tuple(self._endpoints.values()), nodes, owners)
            return self._picture
