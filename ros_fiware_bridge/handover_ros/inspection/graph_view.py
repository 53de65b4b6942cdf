"""Renders the graph: nodes, topics with types and endpoints, services and actions."""

from collections.abc import Iterable
from typing import Any

from handover_ros.graph.port import Endpoint, RosGraph


def of(graph: RosGraph) -> dict[str, Any]:
    """Return the present graph as JSON."""
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
            {"name": service.name, "types": list(service.type_names), "servers": list(service.servers)}
            for service in graph.services()
        ],
        "actions": [
            {"name": action.name, "types": list(action.type_names), "servers": list(action.servers)}
            for action in graph.actions()
        ],
        "problems": [str(problem) for problem in graph.problems()],
    }


def _endpoints(endpoints: Iterable[Endpoint]) -> Iterable[dict[str, Any]]:
    for endpoint in endpoints:
        yield {
            "node": endpoint.node,
            "qos": str(endpoint.qos),
            "middleware": endpoint.vendor,
            "ours": endpoint.ours,
        }


def lines(view: dict[str, Any]) -> Iterable[str]:
    """Yield the lines of a text rendering of `view`."""
    for node in view["nodes"]:
        yield f"node      {node['name']} ({node['middleware']}){' - the bridge' if node['ours'] else ''}"
    for topic in view["topics"]:
        yield f"topic     {topic['name']}  {', '.join(topic['types'])}"
        for role, verb in (("publishers", "from"), ("subscribers", "to")):
            for endpoint in topic[role]:
                node = endpoint["node"] or "a node without a name yet"
                yield f"            {verb} {node} ({endpoint['qos']})"
    for kind in ("services", "actions"):
        for entry in view[kind]:
            served = ", ".join(filter(None, entry["servers"])) or "no node yet"
            yield f"{kind[:-1]:<9} {entry['name']}  {', '.join(entry['types'])}, served by {served}"
    for problem in view["problems"]:
        yield f"problem   {problem}"
