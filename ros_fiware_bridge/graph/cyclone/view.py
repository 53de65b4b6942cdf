"""The graph as the port reports it: topics, services, actions, nodes and incompatibilities.

Pure functions of the state that discovery maintains.
"""

from collections import defaultdict

from ros_fiware_bridge.errors import GraphError, IncompatibleQos, TypeHashDiffers, VendorNotShared
from ros_fiware_bridge.graph.cyclone import dds_names
from ros_fiware_bridge.graph.cyclone.discovery import DiscoveredEndpoint, GraphSnapshot
from ros_fiware_bridge.graph.cyclone.services import VENDOR, vendor_refused
from ros_fiware_bridge.graph.port import ActionInfo, Endpoint, NodeInfo, ServiceInfo, TopicInfo

_HIDDEN = "/_action/"
_SEND_GOAL = "/_action/send_goal"


def topics(snapshot: GraphSnapshot) -> list[TopicInfo]:
    """Return the topics by name."""
    found: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for one in snapshot.endpoints:
        name = dds_names.to_topic(one.topic)
        if name is not None and _HIDDEN not in name:
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
    met: dict[str, list[DiscoveredEndpoint]] = defaultdict(list)
    for one in snapshot.endpoints:
        met[one.topic].append(one)
    found: list[GraphError] = []
    for ends in met.values():
        for ours in ends:
            if ours.participant != snapshot.own:
                continue
            for theirs in ends:
                if theirs.participant != snapshot.own and theirs.writes is not ours.writes:
                    fault = _between(snapshot, ours, theirs)
                    if fault is not None:
                        found.append(fault)
    return found


def _between(
    snapshot: GraphSnapshot, ours: DiscoveredEndpoint, theirs: DiscoveredEndpoint
) -> GraphError | None:
    node = snapshot.node_of(theirs) or f"a program ({theirs.vendor})"
    name = dds_names.to_topic(ours.topic)
    if name is None:
        service = dds_names.to_service(ours.topic)
        if service is None or theirs.vendor == VENDOR or not service[1]:
            return None
        doing = "calls" if theirs.writes else "serves"
        return VendorNotShared(vendor_refused(service[0], theirs, snapshot.node_of(theirs), doing))
    wanted, given = dds_names.to_type(ours.dds_type), dds_names.to_type(theirs.dds_type)
    does = "publishes" if theirs.writes else "subscribes to"
    if wanted != given:
        return TypeHashDiffers(f"{name}: {node} {does} {given}, we use {wanted}; give the rule that type")
    if theirs.type_hash is not None and theirs.type_hash != ours.type_hash:
        return TypeHashDiffers(
            f"{name}: {node} {does} another definition of {wanted} (its hash is {theirs.type_hash}, ours is "
            f"{ours.type_hash}); name the files of its definition in type_paths"
        )
    reader, writer = (theirs, ours) if ours.writes else (ours, theirs)
    why = reader.qos.unmet(writer.qos)
    if why is None:
        return None
    return IncompatibleQos(
        f"{name}: {node} {does} it with {_short(theirs)}, we have {_short(ours)}; {why}, so nothing passes; "
        f"change the quality of service of the rule"
    )


def _short(one: DiscoveredEndpoint) -> str:
    return f"{one.qos.reliability.value}, {one.qos.durability.value}"
