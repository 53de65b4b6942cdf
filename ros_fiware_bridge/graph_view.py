"""The graph as it is shown: topics with their types, who speaks and who listens, services, actions, nodes."""

from collections.abc import Iterable
from typing import Any

from ros_fiware_bridge.graph.port import Endpoint, RosGraph


def of(graph: RosGraph) -> dict[str, Any]:
    """Return what is on the graph now, as JSON has it."""
    return {
        "node": graph.node_name,
        "nodes": [
            {"name": node.full_name, "middleware": node.vendor, "ours": node.ours} for node in graph.nodes()
        ],
        "topics": [
            {
                "name": topic.name,
                "types": list(topic.type_names),
                "publishers": list(_endpoints(topic.publishers)),
                "subscribers": list(_endpoints(topic.subscribers)),
            }
            for topic in graph.topics()
        ],
        "services": [
            {"name": one.name, "types": list(one.type_names), "servers": list(one.servers)}
            for one in graph.services()
        ],
        "actions": [
            {"name": one.name, "types": list(one.type_names), "servers": list(one.servers)}
            for one in graph.actions()
        ],
        "problems": [str(problem) for problem in graph.problems()],
    }


def _endpoints(endpoints: Iterable[Endpoint]) -> Iterable[dict[str, Any]]:
    for one in endpoints:
        yield {"node": one.node, "qos": str(one.qos), "middleware": one.vendor, "ours": one.ours}
