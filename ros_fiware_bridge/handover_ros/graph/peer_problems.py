"""Incompatibilities between our endpoints and those of peers on a topic; shared by the adapters."""

from collections.abc import Iterable

from handover_ros.errors import GraphError, IncompatibleQos, TypeHashDiffers
from handover_ros.graph.port import Endpoint, TopicInfo


def topic_problems(topics: Iterable[TopicInfo]) -> list[GraphError]:
    """Return the incompatibilities between our endpoints and those of others."""
    problems = (
        mismatch(topic.name, reader, writer)
        for topic in topics
        for reader in topic.subscribers
        for writer in topic.publishers
        if reader.ours is not writer.ours
    )
    return [problem for problem in problems if problem is not None]


def mismatch(topic: str, reader: Endpoint, writer: Endpoint) -> GraphError | None:
    """Return why no message passes from `writer` to `reader`, one of which is ours; None if they match."""
    theirs, ours = (writer, reader) if reader.ours else (reader, writer)
    node = theirs.node or f"a program ({theirs.vendor})"
    does = "publishes" if theirs is writer else "subscribes to"
    if theirs.type_name != ours.type_name:
        return TypeHashDiffers(
            f"{topic}: {node} {does} {theirs.type_name}, we use {ours.type_name}; give the rule that type"
        )
    if theirs.type_hash is not None and theirs.type_hash != ours.type_hash:
        return TypeHashDiffers(
            f"{topic}: {node} {does} another definition of {ours.type_name} (its hash is {theirs.type_hash}, "
            f"ours is {ours.type_hash}); name the files of its definition in type_paths"
        )
    why = reader.qos.unmet(writer.qos)
    if why is None:
        return None
    return IncompatibleQos(
        f"{topic}: {node} {does} it with {_short(theirs)}, we have {_short(ours)}; {why}, so nothing passes; "
        "change the quality of service of the rule"
    )


def _short(endpoint: Endpoint) -> str:
    return f"{endpoint.qos.reliability.value}, {endpoint.qos.durability.value}"
