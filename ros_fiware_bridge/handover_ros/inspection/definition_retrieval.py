"""Retrieves message definitions from nodes: ROS 2 Jazzy and later serve `~/get_type_description`.

A definition is accepted only if it has the hash that the endpoint publishes.
"""

import re
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from handover_ros.errors import GraphError, UnknownType
from handover_ros.graph.port import Endpoint, RosGraph
from handover_ros.graph.waiting import until
from handover_ros.types.type_store import TypeStore

SERVICE_TYPE = "type_description_interfaces/srv/GetTypeDescription"
MAX_BYTES = 1_000_000
DISCOVERY_S = 10.0
_TYPE = re.compile(r"(?P<package>[a-z](?:_?[a-z0-9]+)*)/(?P<kind>msg|srv|action)/(?P<name>[A-Z][A-Za-z0-9]*)")

Definitions = Mapping[str, str]
"""The texts of definition files by path, such as `cell_msgs/msg/Part.msg`."""


async def retrieve(
    graph: RosGraph, topic: str, timeout_s: float = 10.0, discovery_s: float = DISCOVERY_S
) -> Definitions:
    """Return the definitions of a topic's type and of all types that it contains.

    It waits until a node on the topic, its name and the hash of its type have been discovered: those come
    separately, and the last of them may take some seconds.

    Raises:
        GraphError: no node on the topic provides them; the text gives the reason for each node.
    """

    def ends() -> list[Endpoint]:
        info = next((candidate for candidate in graph.topics() if candidate.name == topic), None)
        return (
            [endpoint for endpoint in (*info.publishers, *info.subscribers) if not endpoint.ours]
            if info
            else []
        )

    await until(lambda: any(end.node and end.type_hash for end in ends()), discovery_s)
    refused = []
    for end in ends():
        try:
            return await _requested_from(graph, end, timeout_s)
        except GraphError as error:
            refused.append(str(error))
    why = "; ".join(refused) or f"no node uses it, as far as {discovery_s:g} s of discovery show"
    raise GraphError(f"the definition of {topic} cannot be retrieved: {why}; name its files in type_paths")


async def _requested_from(graph: RosGraph, end: Endpoint, timeout_s: float) -> Definitions:
    if end.node is None or end.type_hash is None:
        raise GraphError(
            f"{end.node or 'a node without a name'} publishes no type hash (ROS 2 Iron and later do)"
        )
    request = {"type_name": end.type_name, "type_hash": end.type_hash, "include_type_sources": True}
    answer = await graph.call(f"{end.node}/get_type_description", SERVICE_TYPE, request, timeout_s)
    if not answer["successful"]:
        raise GraphError(f"{end.node} answered: {answer['failure_reason']}")
    files = dict(_files(end.node, answer["type_sources"]))
    with tempfile.TemporaryDirectory() as folder:
        write(files, Path(folder))
        type_hash = TypeStore([Path(folder)]).hash(end.type_name)
    if type_hash != end.type_hash:
        raise GraphError(
            f"{end.node} provided another definition of {end.type_name} than it uses ({type_hash})"
        )
    return files


def _files(node: str, sources: Iterable[Mapping[str, Any]]) -> Iterable[tuple[str, str]]:
    size = 0
    for source in sources:
        named, text = _TYPE.fullmatch(source["type_name"]), source["raw_file_contents"]
        size += len(text)
        if size > MAX_BYTES:
            raise GraphError(f"{node} provides more than {MAX_BYTES} bytes of definitions")
        if named is None or source["encoding"] != named["kind"]:
            continue  # a request, a response, or another form of the same definition
        yield f"{named['package']}/{named['kind']}/{named['name']}.{named['kind']}", text


def write(definitions: Definitions, folder: Path) -> None:
    """Write definition files below `folder`, in the layout that `type_paths` expects.

    Raises:
        UnknownType: `definitions` is empty.
    """
    if not definitions:
        raise UnknownType("no definition was provided")
    for name, text in definitions.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
