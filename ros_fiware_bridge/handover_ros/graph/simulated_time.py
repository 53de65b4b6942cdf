"""Whether a graph runs on simulated time: its stamps are then no times since 1970.

A simulator, or a player of a recording, publishes `/clock`, and nodes with `use_sim_time` stamp by it. It
begins at 0 as a rule, and runs at any speed. So such stamps order the messages of the graph and say nothing
about when something was observed; the time of reception does.
"""

from collections.abc import Iterator

from handover_ros.graph.port import RosGraph

CLOCK = "/clock"
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"


def clock_publishers(graph: RosGraph) -> list[str]:
    """Return the nodes that publish simulated time."""
    return [
        publisher.node or "a node without a name"
        for topic in graph.topics()
        if topic.name == CLOCK
        for publisher in topic.publishers
        if not publisher.ours and publisher.type_name == CLOCK_TYPE
    ]


def notes(graph: RosGraph) -> Iterator[str]:
    """Yield what a person should know of the time of a graph."""
    if nodes := clock_publishers(graph):
        yield (
            f"the graph runs on simulated time ({CLOCK} is published by {', '.join(nodes)}): observedAt is "
            "the time of reception, not the stamp of a message"
        )
