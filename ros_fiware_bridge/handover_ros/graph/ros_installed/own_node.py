"""Our node in an installed ROS: it spins in its own threads, and messages are converted by CDR.

The installed ROS defines its types by Python modules, the bridge by definition files. If they differed,
messages would be misread: so their hashes are compared when a topic is opened.
"""

import asyncio
import os
import threading
from collections.abc import Callable
from typing import Any

import structlog

from handover_ros.errors import AdapterUnavailable, TypeHashDiffers, UnknownType
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.port import Message
from handover_ros.graph.qos import Durability, History, Qos, Reliability
from handover_ros.graph.ros_installed.fast_dds_types import defined_class, installed_class, supports
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_SPIN_TIMEOUT_S = 1.0
DISCOVERY_DELAY_S = 0.5
"""A server that has been discovered may not have discovered our client yet, and its response would be lost.
Nothing reports when it has, so the first call waits this long.
"""
_MAX_THREADS = 64
"""Each handler of a service or goal occupies a thread while it runs."""


class OwnRosNode:
    """The bridge as an rclpy node."""

    def __init__(self, settings: JoinSettings, store: TypeStore) -> None:
        """Start the node and its threads.

        Raises:
            AdapterUnavailable: the installed ROS does not start.
        """
        import rclpy  # noqa: PLC0415 - is only there where ROS is
        from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: PLC0415
        from rclpy.executors import MultiThreadedExecutor  # noqa: PLC0415
        from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415

        self.store = store
        for name, value in _network(settings).items():
            os.environ.setdefault(name, value)  # the configuration of the machine has priority
        self._context = rclpy.Context()
        try:
            rclpy.init(
                args=["--ros-args", "-e", settings.enclave],
                context=self._context,
                domain_id=settings.domain_id,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            self.node: Any = rclpy.create_node(
                settings.node, namespace=settings.namespace, context=self._context, use_global_arguments=False
            )
        except Exception as error:
            raise AdapterUnavailable(f"the installed ROS does not start: {error}") from error
        self.vendor = rclpy.get_rmw_implementation_identifier()
        self.group = ReentrantCallbackGroup()
        self._executor = MultiThreadedExecutor(_MAX_THREADS, context=self._context)
        self._executor.add_node(self.node)
        self._stopping = False
        self._thread = threading.Thread(target=self._spin, name="ros-graph", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException  # noqa: PLC0415 - where ROS is

        while not self._stopping and self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=_SPIN_TIMEOUT_S)
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception:
                # The error of one callback, or an entity that was closed meanwhile: the others continue.
                if not self._stopping:
                    log.exception("spinning the ROS node failed")

    def same(self, where: str, type_name: str, theirs: str | None) -> None:
        """Check that the installed ROS has the same definition of a type.

        Raises:
            TypeHashDiffers: it has another definition.
        """
        ours = self.store.hash(type_name)
        if theirs is not None and theirs != ours:
            raise TypeHashDiffers(
                f"{where}: the installed ROS has another definition of {type_name} (its hash is {theirs}, "
                f"ours is {ours}); name the share folder of its package in type_paths"
            )

    def to_ros(self, made: Any, type_name: str, message: Message) -> Any:
        """Return `message` as an instance of the Python class `made`."""
        from rclpy.serialization import deserialize_message  # noqa: PLC0415 - is only there where ROS is

        return deserialize_message(self.store.encode(type_name, message), made)

    def from_ros(self, type_name: str, message: Any) -> Message:
        """Return an instance of a Python class as a message."""
        from rclpy.serialization import serialize_message  # noqa: PLC0415 - is only there where ROS is

        return self.store.decode(type_name, serialize_message(message))

    def close(self) -> None:
        """Stop the node and its threads."""
        import rclpy  # noqa: PLC0415 - is only there where ROS is

        self._stopping = True
        self._executor.shutdown(timeout_sec=2.0)
        self._thread.join(5.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


def interface(type_name: str, store: TypeStore) -> Any:
    """Return the Python class of a message, service or action type; made from its definition if need be.

    Raises:
        UnknownType: the installed ROS has no such type, and none can be made for it.
    """
    import rclpy  # noqa: PLC0415 - is only there where ROS is

    try:
        return installed_class(type_name)
    except Exception as error:
        if supports(rclpy.get_rmw_implementation_identifier()):
            return defined_class(store, type_name)
        built = f"ros-jazzy-{type_name.split('/', maxsplit=1)[0].replace('_', '-')}"
        raise UnknownType(
            f"rclpy has no {type_name}; install its package ({built}), build it in a workspace and "
            "source that, or start the robot's node with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, for which "
            "definition files are enough"
        ) from error


def _network(settings: JoinSettings) -> dict[str, str]:
    """Return the environment variables that configure ROS 2 for the network of `settings`."""
    variables = {}
    if settings.peers:
        variables["ROS_STATIC_PEERS"] = ";".join(settings.peers)
    if settings.interfaces and all(
        network == "lo" or network.startswith("127.") for network in settings.interfaces
    ):
        variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    return variables


def profile(qos: Qos, depth: int | None = None) -> Any:
    """Return the QoS profile of rclpy."""
    from rclpy import qos as ros  # noqa: PLC0415 - is only there where ROS is

    keep_all = qos.history is History.KEEP_ALL
    return ros.QoSProfile(
        reliability=ros.ReliabilityPolicy[qos.reliability.name],
        durability=ros.DurabilityPolicy[qos.durability.name],
        history=ros.HistoryPolicy.KEEP_ALL if keep_all else ros.HistoryPolicy.KEEP_LAST,
        depth=depth or qos.depth,
    )


def offered(policies: Any) -> Qos:
    """Return the QoS that an endpoint of the installed ROS offers or requests."""
    best_effort = policies.reliability.name == "BEST_EFFORT"
    late = policies.durability.name == "TRANSIENT_LOCAL"
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if late else Durability.VOLATILE,
    )


def hash_of(endpoint: Any) -> str | None:
    """Return the type hash of an endpoint, `RIHS01_…`; None if it publishes none."""
    published = str(endpoint.topic_type_hash)
    return published if published.startswith("RIHS01_") else None


def as_future(pending: Any, loop: asyncio.AbstractEventLoop) -> asyncio.Future[Any]:
    """Return a future of the loop with the result of a future of rclpy."""
    mine: asyncio.Future[Any] = loop.create_future()

    def settle() -> None:
        if mine.done():
            return
        if pending.exception() is not None:
            mine.set_exception(pending.exception())
        else:
            mine.set_result(pending.result())

    def ended(_: Any) -> None:
        call(loop, settle)

    pending.add_done_callback(ended)
    return mine


def call(loop: asyncio.AbstractEventLoop, function: Callable[..., Any], *arguments: Any) -> None:
    """Call a function in the loop; has no effect if the loop is closed."""
    try:
        loop.call_soon_threadsafe(function, *arguments)
    except RuntimeError:
        return
