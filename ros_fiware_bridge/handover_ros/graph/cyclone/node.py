"""Our node: its participant and endpoints, and its discovery data.

Each endpoint publishes its type hash, and `ros_discovery_info` assigns the endpoints to the node; so
`ros2 node info` displays the bridge like any other node.
"""

from typing import Any

from handover_ros.errors import AdapterUnavailable
from handover_ros.graph.cyclone import dds_names, dds_qos, domain
from handover_ros.graph.cyclone.discovery import Discovery
from handover_ros.graph.cyclone.idl_types import IdlTypes
from handover_ros.graph.cyclone.listener_thread import ListenerThread
from handover_ros.graph.cyclone.samples import SampleSender
from handover_ros.graph.qos import Durability, Qos
from handover_ros.types.type_store import TypeStore

_DISCOVERY_WRITER_QOS = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_DISCOVERY_READER_QOS = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1000)


class OwnNode:
    """The bridge on DDS. Used from one thread; the callbacks of its readers run in the listener thread."""

    def __init__(
        self, settings: domain.DomainSettings, store: TypeStore, name: str, namespace: str, enclave: str
    ) -> None:
        """Join the domain.

        Raises:
            AdapterUnavailable: the domain cannot be opened, or has reached its limit of programs.
        """
        from cyclonedds.core import DDSException  # noqa: PLC0415 - heavy
        from cyclonedds.domain import DomainParticipant  # noqa: PLC0415
        from cyclonedds.pub import Publisher  # noqa: PLC0415
        from cyclonedds.qos import Policy  # noqa: PLC0415
        from cyclonedds.qos import Qos as DdsQos  # noqa: PLC0415
        from cyclonedds.sub import Subscriber  # noqa: PLC0415

        self.name, self.namespace = name, namespace
        self.store = store
        self._settings = settings
        domain.enter(settings)
        try:
            self._participant = DomainParticipant(
                settings.domain_id,
                qos=DdsQos(Policy.Userdata(dds_names.user_data({"enclave": enclave}))),
            )
        except DDSException as error:
            domain.leave(settings)
            raise AdapterUnavailable(
                f"ROS domain {settings.domain_id} has reached its limit of programs ({error}); "
                "stop another program, or use another domain"
            ) from error
        self._publisher = Publisher(self._participant)
        self._subscriber = Subscriber(self._participant)
        self._types = IdlTypes(store.definition)
        self._readers: dict[int, Any] = {}
        self._writers: dict[int, Any] = {}
        self.sender = SampleSender()
        self.discovery = Discovery(self._participant, store)
        self.listener = ListenerThread(self._participant)
        for reader, take in self.discovery.readers:
            self.listener.to(reader, take)
        self._discovery_writer = self.writer(
            dds_names.DISCOVERY_TOPIC, dds_names.DISCOVERY_TYPE, _DISCOVERY_WRITER_QOS, announced=False
        )
        discovery_reader = self.reader(
            dds_names.DISCOVERY_TOPIC, dds_names.DISCOVERY_TYPE, _DISCOVERY_READER_QOS, announced=False
        )
        self.listener.to_samples(discovery_reader, self.discovery.on_node_info)
        self._announce()

    def reader(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        user: dict[str, str] | None = None,
        header: bool = False,
        announced: bool = True,
    ) -> Any:
        """Open a reader of a DDS topic; `header` is for the topics of services."""
        from cyclonedds.sub import DataReader  # noqa: PLC0415 - heavy

        opened = DataReader(
            self._subscriber,
            self._topic(topic, type_name, header),
            qos=dds_qos.of_reader(qos, dds_names.user_data(user or {})),
        )
        if announced:
            self._readers[id(opened)] = opened
            self._announce()
        return opened

    def writer(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        user: dict[str, str] | None = None,
        header: bool = False,
        announced: bool = True,
    ) -> Any:
        """Open a writer on a DDS topic; `header` is for the topics of services."""
        from cyclonedds.pub import DataWriter  # noqa: PLC0415 - heavy

        opened = DataWriter(
            self._publisher,
            self._topic(topic, type_name, header),
            qos=dds_qos.of_writer(qos, dds_names.user_data(user or {})),
        )
        if announced:
            self._writers[id(opened)] = opened
            self._announce()
        return opened

    def _topic(self, topic: str, type_name: str, header: bool) -> Any:
        from cyclonedds.topic import Topic  # noqa: PLC0415 - heavy

        return Topic(self._participant, topic, self._types.of(type_name, with_header=header))

    def drop(self, *opened: Any) -> None:
        """Close readers and writers that are no longer used."""
        for entity in opened:
            self._readers.pop(id(entity), None)
            self._writers.pop(id(entity), None)
        self._announce()
        for entity in opened:
            entity.__del__()
            entity.topic.__del__()

    def _announce(self) -> None:
        info = {
            "gid": {"data": self.discovery.own},
            "node_entities_info_seq": [
                {
                    "node_namespace": self.namespace,
                    "node_name": self.name,
                    "reader_gid_seq": [
                        {"data": entity.get_guid().bytes} for entity in self._readers.values()
                    ],
                    "writer_gid_seq": [
                        {"data": entity.get_guid().bytes} for entity in self._writers.values()
                    ],
                }
            ],
        }
        self.sender.write(self._discovery_writer, self.store.encode(dds_names.DISCOVERY_TYPE, info))

    def close(self) -> None:
        """Leave the domain; this closes everything opened in it."""
        self.listener.stop()
        self._participant.__del__()
        domain.leave(self._settings)
