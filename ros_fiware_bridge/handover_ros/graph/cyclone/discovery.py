"""Discovery: the participants, endpoints and nodes of the graph.

DDS reports participants and their endpoints; each participant publishes on `ros_discovery_info` which of its
endpoints belong to which node. The listener thread writes this state, the loop reads it.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import structlog

from handover_ros.errors import BadMessage
from handover_ros.graph.cyclone import dds_names, dds_qos
from handover_ros.graph.cyclone.samples import Sample
from handover_ros.graph.qos import Qos
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_MAX_SAMPLES_PER_TAKE = 100
_ALIVE = 16


@dataclass(frozen=True, slots=True)
class DiscoveredEndpoint:
    """A discovered endpoint; `guid` and `participant` are 16 bytes."""

    handle: int
    guid: bytes
    participant: bytes
    writes: bool
    topic: str
    """The DDS topic, `rt/joint_states`."""
    dds_type: str
    qos: Qos
    user_data: dict[str, str]

    @property
    def vendor(self) -> str:
        """Return the middleware of the endpoint."""
        return dds_names.vendor(self.participant)

    @property
    def type_hash(self) -> str | None:
        """Return the type hash, `RIHS01_…`, if the endpoint publishes it."""
        return self.user_data.get("typehash")


def handles(matched: list[int]) -> set[int]:
    """Return instance handles as unsigned numbers; the binding returns those of matches as signed ones."""
    return {handle % 2**64 for handle in matched}


@dataclass(frozen=True, slots=True)
class DiscoveredNode:
    """A discovered node and the GUIDs of its endpoints."""

    name: str
    namespace: str
    participant: bytes
    enclave: str
    guids: frozenset[bytes]

    @property
    def full_name(self) -> str:
        """Return the name with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """The state of the graph at one moment."""

    own: bytes
    endpoints: tuple[DiscoveredEndpoint, ...] = ()
    nodes: tuple[DiscoveredNode, ...] = ()
    _node_of: dict[bytes, str] = field(default_factory=dict)

    def node_of(self, endpoint: DiscoveredEndpoint) -> str | None:
        """Return the full name of an endpoint's node, if it is known."""
        return self._node_of.get(endpoint.guid)

    def at(self, topic: str, *, writes: bool) -> list[DiscoveredEndpoint]:
        """Return the writers or readers of a DDS topic."""
        return [
            endpoint for endpoint in self.endpoints if endpoint.topic == topic and endpoint.writes is writes
        ]


class Discovery:
    """Maintains the state of the graph."""

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
        self._endpoints: dict[bytes, DiscoveredEndpoint] = {}
        self._writers: dict[int, DiscoveredEndpoint] = {}
        self._nodes: dict[bytes, tuple[DiscoveredNode, ...]] = {}
        self._snapshot: GraphSnapshot | None = None
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
            while samples := reader.take(N=_MAX_SAMPLES_PER_TAKE):
                with self._lock:
                    self._snapshot = None
                    for sample in samples:
                        try:
                            seen(sample)
                        except Exception:  # one malformed peer must not hide the others
                            log.exception("processing discovery data of a peer failed")

        return take

    def look(self) -> None:
        """Process pending discovery data at once; in the listener thread only."""
        for _, take in self.readers:
            take()

    def _participant(self, sample: Any) -> None:
        key = sample.key.bytes
        if sample.sample_info.valid_data and sample.sample_info.instance_state == _ALIVE:
            self._enclaves[key] = dds_names.parse_user_data(dds_qos.user_data_of(sample.qos)).get(
                "enclave", "/"
            )
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
        endpoint = DiscoveredEndpoint(
            info.instance_handle,
            key,
            sample.participant_key.bytes,
            writes,
            sample.topic_name,
            sample.type_name,
            dds_qos.offered(sample.qos),
            dds_names.parse_user_data(dds_qos.user_data_of(sample.qos)),
        )
        self._endpoints[key] = endpoint
        if writes:
            self._writers[endpoint.handle] = endpoint

    def on_node_info(self, samples: list[Sample]) -> None:
        """Process what participants publish about their nodes."""
        for sample in samples:
            if sample.data is None:
                continue
            try:
                info = self._store.decode(dds_names.DISCOVERY_TYPE, sample.data)
            except BadMessage:
                continue  # nodes of ROS releases with another format have no name
            participant = info["gid"]["data"]
            with self._lock:
                enclave = self._enclaves.get(participant, "/")
                self._snapshot = None
                self._nodes[participant] = tuple(
                    DiscoveredNode(
                        entry["node_name"],
                        entry["node_namespace"],
                        participant,
                        enclave,
                        frozenset(
                            gid["data"] for gid in (*entry["reader_gid_seq"], *entry["writer_gid_seq"])
                        ),
                    )
                    for entry in info["node_entities_info_seq"]
                )

    def writer(self, handle: int) -> DiscoveredEndpoint | None:
        """Return the writer with that instance handle, if it is known."""
        with self._lock:
            return self._writers.get(handle)

    def known_writer(self, handle: int) -> DiscoveredEndpoint | None:
        """Return `writer(handle)` after pending discovery data, if need be; in the listener thread only."""
        endpoint = self.writer(handle)
        if endpoint is None:
            self.look()
            endpoint = self.writer(handle)
        return endpoint

    def snapshot(self) -> GraphSnapshot:
        """Return the present state of the graph."""
        with self._lock:
            if self._snapshot is None:
                # The data of a node may outlive its participant.
                nodes = tuple(
                    node for key, nodes in self._nodes.items() if key in self._enclaves for node in nodes
                )
                owners = {guid: node.full_name for node in nodes for guid in node.guids}
                self._snapshot = GraphSnapshot(self.own, tuple(self._endpoints.values()), nodes, owners)
            return self._snapshot
