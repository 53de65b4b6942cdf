"""The graph as the port reports it: topics, services, actions, nodes and incompatibilities.

Pure functions of the state that discovery maintains.
"""

from collections import defaultdict
from collections.abc import Iterator

from handover_ros.errors import GraphError, VendorNotShared
from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint, GraphSnapshot
from handover_ros.graph.cyclone.services import VENDOR, vendor_refused
from handover_ros.graph.peer_problems import topic_problems
from handover_ros.graph.port import ActionInfo, Endpoint, NodeInfo, ServiceInfo, TopicInfo

_HIDDEN = "/_action/"
_SEND_GOAL = "/_action/send_goal"


def topics(snapshot: GraphSnapshot) -> list[TopicInfo]:
    """Return the topics by name, without those of actions."""
    return [topic for topic in _all_topics(snapshot) if _HIDDEN not in topic.name]


def _all_topics(snapshot: GraphSnapshot) -> list[TopicInfo]:
    by_topic: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for endpoint in snapshot.endpoints:
        name = dds_names.to_topic(endpoint.topic)
        if name is not None:
            by_topic[name].append(endpoint)
    return [
        TopicInfo(
            name,
            tuple(sorted({dds_names.to_type(endpoint.dds_type) for endpoint in ends})),
            tuple(_endpoint(snapshot, endpoint) for endpoint in ends if endpoint.writes),
            tuple(_endpoint(snapshot, endpoint) for endpoint in ends if not endpoint.writes),
        )
        for name, ends in sorted(by_topic.items())
    ]


def _endpoint(snapshot: GraphSnapshot, endpoint: DiscoveredEndpoint) -> Endpoint:
    ours = endpoint.participant == snapshot.own
    type_name = dds_names.to_type(endpoint.dds_type)
    return Endpoint(
        snapshot.node_of(endpoint), type_name, endpoint.qos, endpoint.type_hash, endpoint.vendor, ours
    )


def services(snapshot: GraphSnapshot) -> list[ServiceInfo]:
    """Return the services by name."""
    return [
        ServiceInfo(
            name,
            _bases(requests),
            tuple(snapshot.node_of(endpoint) for endpoint in requests if not endpoint.writes),
            tuple(snapshot.node_of(endpoint) for endpoint in requests if endpoint.writes),
            tuple(sorted({endpoint.vendor for endpoint in requests if not endpoint.writes})),
        )
        for name, requests in _requests(snapshot)
        if _HIDDEN not in name
    ]


def actions(snapshot: GraphSnapshot) -> list[ActionInfo]:
    """Return the actions by name."""
    return [
        ActionInfo(
            name.removesuffix(_SEND_GOAL),
            tuple(base.removesuffix("_SendGoal") for base in _bases(requests)),
            tuple(snapshot.node_of(endpoint) for endpoint in requests if not endpoint.writes),
            tuple(snapshot.node_of(endpoint) for endpoint in requests if endpoint.writes),
        )
        for name, requests in _requests(snapshot)
        if name.endswith(_SEND_GOAL)
    ]


def _requests(snapshot: GraphSnapshot) -> list[tuple[str, list[DiscoveredEndpoint]]]:
    by_service: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for endpoint in snapshot.endpoints:
        service = dds_names.to_service(endpoint.topic)
        if service is not None and service[1]:
            by_service[service[0]].append(endpoint)
    return sorted(by_service.items())


def _bases(requests: list[DiscoveredEndpoint]) -> tuple[str, ...]:
    return tuple(
        sorted({dds_names.to_type(endpoint.dds_type).removesuffix("_Request") for endpoint in requests})
    )


def nodes(snapshot: GraphSnapshot) -> list[NodeInfo]:
    """Return the nodes by full name."""
    shown = [
        NodeInfo(
            node.name,
            node.namespace,
            node.enclave,
            dds_names.vendor(node.participant),
            node.participant == snapshot.own,
        )
        for node in snapshot.nodes
    ]
    return sorted(shown, key=lambda node: node.full_name)


def problems(snapshot: GraphSnapshot) -> list[GraphError]:
    """Return the incompatibilities between our endpoints and their peers on topics and services."""
    return [*topic_problems(_all_topics(snapshot)), *_service_problems(snapshot)]


def _service_problems(snapshot: GraphSnapshot) -> Iterator[GraphError]:
    for name, requests in _requests(snapshot):
        for ours in requests:
            if ours.participant != snapshot.own:
                continue
            for theirs in requests:
                if theirs.writes is not ours.writes and theirs.vendor != VENDOR:
                    doing = "calls" if theirs.writes else "serves"
                    yield VendorNotShared(vendor_refused(name, theirs, snapshot.node_of(theirs), doing))
