"""Our node: the participant, its endpoints, and what it tells the graph about itself.

Each endpoint says which type it means (its hash), and `ros_discovery_info` says that it is ours; so
`ros2 node info` shows the bridge as it shows any node.
"""

from typing import Any

from ros_fiware_bridge.errors import AdapterUnavailable
from ros_fiware_bridge.graph.cyclone import dds_names, dds_qos, domain
from ros_fiware_bridge.graph.cyclone.discovery import Discovery
from ros_fiware_bridge.graph.cyclone.idl_types import IdlTypes
from ros_fiware_bridge.graph.cyclone.listening import Listening
from ros_fiware_bridge.graph.cyclone.samples import Sender
from ros_fiware_bridge.graph.qos import Durability, Qos
from ros_fiware_bridge.types.type_store import TypeStore

_TELLING = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_HEARING = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1000)


class OwnNode:
    """The bridge on DDS. Used from one thread; what it listens to runs in the listening thread."""

    def __init__(
        self, settings: domain.DomainSettings, store: TypeStore, name: str, namespace: str, enclave: str
    ) -> None:
        """Join the domain.

        Raises:
            AdapterUnavailable: the domain cannot be opened, or has no room for one more program.
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
                f"ROS domain {settings.domain_id} has no room for this program ({error}); "
                "end another, or use another domain"
            ) from error
        self._publisher = Publisher(self._participant)
        self._subscriber = Subscriber(self._participant)
        self._types = IdlTypes(store.definition)
        self._readers: dict[int, Any] = {}
        self._writers: dict[int, Any] = {}
        self.sender = Sender()
        self.discovery = Discovery(self._participant, store)
        self.listening = Listening(self._participant)
        for reader, take in self.discovery.readers:
            self.listening.to(reader, take)
        self._telling = self.writer(dds_names.DISCOVERY_TOPIC, dds_names.DISCOVERY_TYPE, _TELLING, told=False)
        hearing = self.reader(dds_names.DISCOVERY_TOPIC, dds_names.DISCOVERY_TYPE, _HEARING, told=False)
        self.listening.to_samples(hearing, self.discovery.on_node_info)
        self._tell()

    def reader(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        user: dict[str, str] | None = None,
        header: bool = False,
        told: bool = True,
    ) -> Any:
        """Open a reader of a DDS topic; with `header` it is one of a service."""
        from cyclonedds.sub import DataReader  # noqa: PLC0415 - heavy

        opened = DataReader(
            self._subscriber,
            self._topic(topic, type_name, header),
            qos=dds_qos.of_reader(qos, dds_names.user_data(user or {})),
        )
        if told:
            self._readers[id(opened)] = opened
            self._tell()
        return opened

    def writer(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        user: dict[str, str] | None = None,
        header: bool = False,
        told: bool = True,
    ) -> Any:
        """Open a writer on a DDS topic; with `header` it is one of a service."""
        from cyclonedds.pub import DataWriter  # noqa: PLC0415 - heavy

        opened = DataWriter(
            self._publisher,
            self._topic(topic, type_name, header),
            qos=dds_qos.of_writer(qos, dds_names.user_data(user or {})),
        )
        if told:
            self._writers[id(opened)] = opened
            self._tell()
        return opened

    def _topic(self, topic: str, type_name: str, header: bool) -> Any:
        from cyclonedds.topic import Topic  # noqa: PLC0415 - heavy

        return Topic(self._participant, topic, self._types.of(type_name, with_header=header))

    def drop(self, *opened: Any) -> None:
        """Close readers and writers that nothing listens to any more."""
        for one in opened:
            self._readers.pop(id(one), None)
            self._writers.pop(id(one), None)
        self._tell()
        for one in opened:
            one.__del__()
            one.topic.__del__()

    def _tell(self) -> None:
        told = {
            "gid": {"data": self.discovery.own},
            "node_entities_info_seq": [
                {
                    "node_namespace": self.namespace,
                    "node_name": self.name,
                    "reader_gid_seq": [{"data": one.get_guid().bytes} for one in self._readers.values()],
                    "writer_gid_seq": [{"data": one.get_guid().bytes} for one in self._writers.values()],
                }
            ],
        }
        self.sender.write(self._telling, self.store.encode(dds_names.DISCOVERY_TYPE, told))

    def close(self) -> None:
        """Leave the domain; all that was opened is closed with it."""
        self.listening.stop()
        self._participant.__del__()
        domain.leave(self._settings)
