"""The graph as the port reports it, from the functions of an installed ROS."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

from handover_ros.graph.port import ActionInfo, Endpoint, NodeInfo, ServiceInfo, TopicInfo
from handover_ros.graph.ros_installed.own_node import hash_of, offered

_HIDDEN = "/_action/"
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


def full_name(endpoint: Any) -> str:
    """Return the full name of the node that an endpoint belongs to."""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def topics(node: Any, ours: str) -> list[TopicInfo]:
    """Return the topics by name."""

    def ends(infos: list[Any]) -> tuple[Endpoint, ...]:
        return tuple(
            Endpoint(
                None if info.node_name == _UNKNOWN else full_name(info),
                info.topic_type,
                offered(info.qos_profile),
                hash_of(info),
                _vendor(bytes(info.endpoint_gid)),
                full_name(info) == ours,
            )
            for info in infos
        )

    return [
        TopicInfo(
            name,
            tuple(sorted(types)),
            ends(node.get_publishers_info_by_topic(name)),
            ends(node.get_subscriptions_info_by_topic(name)),
        )
        for name, types in sorted(node.get_topic_names_and_types())
        if _HIDDEN not in name
    ]


def _vendor(gid: bytes) -> str:
    return {b"\x01\x0f": "fastdds", b"\x01\x10": "cyclonedds", b"\x01\x01": "connext"}.get(gid[:2], "unknown")


def _by_node(node: Any, ask: Callable[[str, str], Any]) -> Iterator[tuple[str, str, list[str]]]:
    """Yield (node, name, types) from `ask` for each node; a node that has left is skipped."""
    for name, namespace in node.get_node_names_and_namespaces():
        try:
            names = ask(name, namespace)
        except RuntimeError:
            continue
        for topic, types in names:
            yield f"{namespace.rstrip('/')}/{name}", topic, types


def services(node: Any, vendor: str) -> list[ServiceInfo]:
    """Return the services by name; their vendor is the middleware of the installed ROS."""
    servers: dict[str, list[str]] = defaultdict(list)
    clients: dict[str, list[str]] = defaultdict(list)
    types: dict[str, set[str]] = defaultdict(set)
    for owner, name, kinds in _by_node(node, node.get_service_names_and_types_by_node):
        servers[name].append(owner)
        types[name].update(kinds)
    for owner, name, kinds in _by_node(node, node.get_client_names_and_types_by_node):
        clients[name].append(owner)
        types[name].update(kinds)
    return [
        ServiceInfo(name, tuple(sorted(types[name])), tuple(servers[name]), tuple(clients[name]), (vendor,))
        for name in sorted(types)
        if _HIDDEN not in name
    ]


def actions(node: Any) -> list[ActionInfo]:
    """Return the actions by name."""
    from rclpy import action  # noqa: PLC0415 - is only there where ROS is

    def owners_by_name(ask: Callable[[Any, str, str], Any]) -> dict[str, list[str]]:
        owners: dict[str, list[str]] = defaultdict(list)
        for owner, name, kinds in _by_node(node, lambda node_name, inside: ask(node, node_name, inside)):
            owners[name].append(owner)
            types[name].update(kinds)
        return owners

    types: dict[str, set[str]] = defaultdict(set)
    servers = owners_by_name(action.get_action_server_names_and_types_by_node)
    clients = owners_by_name(action.get_action_client_names_and_types_by_node)
    return [
        ActionInfo(
            name, tuple(sorted(types[name])), tuple(servers.get(name, ())), tuple(clients.get(name, ()))
        )
        for name in sorted(types)
    ]


def nodes(node: Any, ours: str, vendor: str) -> list[NodeInfo]:
    """Return the nodes by full name; their vendor is the middleware of the installed ROS."""
    infos = [
        NodeInfo(name, namespace, enclave, vendor, f"{namespace.rstrip('/')}/{name}" == ours)
        for name, namespace, enclave in node.get_node_names_and_namespaces_with_enclaves()
    ]
    return sorted(infos, key=lambda info: info.full_name)
