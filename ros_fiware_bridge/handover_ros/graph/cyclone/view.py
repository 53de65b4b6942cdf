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
    return [one for one in _all_topics(snapshot) if _HIDDEN not in one.name]


def _all_topics(snapshot: GraphSnapshot) -> list[TopicInfo]:
    found: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for one in snapshot.endpoints:
        name = dds_names.to_topic(one.topic)
        if name is not None:
            found[name].append(one)
    return [
        TopicInfo(
            name,
            tuple(sorted({dds_names.to_type(one.dds_type) for one in ends})),
            tuple(_endpoint(snapshot, one) for one in ends if one.writes),
            tuple(_endpoint(snapshot, one) for one in ends if not one.writes),
        )
        for name, ends in sorted(found.items())
    ]


def _endpoint(snapshot: GraphSnapshot, one: DiscoveredEndpoint) -> Endpoint:
    ours = one.participant == snapshot.own
    type_name = dds_names.to_type(one.dds_type)
    return Endpoint(snapshot.node_of(one), type_name, one.qos, one.type_hash, one.vendor, ours)


def services(snapshot: GraphSnapshot) -> list[ServiceInfo]:
    """Return the services by name."""
    return [
        ServiceInfo(
            name,
            _bases(requests),
            tuple(snapshot.node_of(one) for one in requests if not one.writes),
            tuple(snapshot.node_of(one) for one in requests if one.writes),
            tuple(sorted({one.vendor for one in requests if not one.writes})),
        )
        for name, requests in _requests(snapshot)
        if _HIDDEN not in name
    ]


def actions(snapshot: GraphSnapshot) -> list[ActionInfo]:
    """Return the actions by name."""
    return [
        ActionInfo(
            name.removesuffix(_SEND_GOAL),
            tuple(one.removesuffix("_SendGoal") for one in _bases(requests)),
            tuple(snapshot.node_of(one) for one in requests if not one.writes),
            tuple(snapshot.node_of(one) for one in requests if one.writes),
        )
        for name, requests in _requests(snapshot)
        if name.endswith(_SEND_GOAL)
    ]


def _requests(snapshot: GraphSnapshot) -> list[tuple[str, list[DiscoveredEndpoint]]]:
    found: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for one in snapshot.endpoints:
        service = dds_names.to_service(one.topic)
        if service is not None and service[1]:
            found[service[0]].append(one)
    return sorted(found.items())


def _bases(requests: list[DiscoveredEndpoint]) -> tuple[str, ...]:
    return tuple(sorted({dds_names.to_type(one.dds_type).removesuffix("_Request") for one in requests}))


def nodes(snapshot: GraphSnapshot) -> list[NodeInfo]:
    """Return the nodes by full name."""
    found = [
        NodeInfo(
            one.name,
            one.namespace,
            one.enclave,
            dds_names.vendor(one.participant),
            one.participant == snapshot.own,
        )
        for one in snapshot.nodes
    ]
    return sorted(found, key=lambda one: one.full_name)


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
