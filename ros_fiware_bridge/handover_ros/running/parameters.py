"""The ROS parameters of the bridge's node, for `ros2 param list` and `ros2 param get`.

They are read-only: the graph has no users, and a node must not enable a rule that a person has disabled.
"""

from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack, suppress
from typing import Any, Self

from handover.telemetry import get_logger
from handover_ros.errors import GraphError
from handover_ros.graph.port import Message, RosGraph

log = get_logger(__name__)

Values = Mapping[str, bool | str]
_NOT_SET, _BOOL, _STRING = 0, 1, 4  # the constants of rcl_interfaces/msg/ParameterType


class Parameters:
    """Serves the parameters that `values` returns, while it is entered."""

    def __init__(self, graph: RosGraph, values: Callable[[], Values]) -> None:
        self._graph = graph
        self._values = values
        self._served = AsyncExitStack()

    async def __aenter__(self) -> Self:
        for name, type_name, handler in (
            ("list_parameters", "ListParameters", self._list),
            ("get_parameters", "GetParameters", self._get),
            ("set_parameters", "SetParameters", self._set),
        ):
            try:
                served = await self._graph.serve(f"~/{name}", f"rcl_interfaces/srv/{type_name}", handler)
            except GraphError as error:
                log.info("parameters are not served", error=str(error))
                return self
            self._served.push_async_callback(served.close)
        return self

    async def __aexit__(self, *_: object) -> None:
        with suppress(GraphError):
            await self._served.aclose()

    async def _list(self, request: Message) -> Message:
        prefixes = request["prefixes"]
        names = sorted(
            name
            for name in self._values()
            if not prefixes or any(name == prefix or name.startswith(f"{prefix}.") for prefix in prefixes)
        )
        above = {name.rpartition(".")[0] for name in names} - {""}
        return {"result": {"names": names, "prefixes": sorted(above)}}

    async def _get(self, request: Message) -> Message:
        values = self._values()
        return {"values": [_parameter(values.get(name)) for name in request["names"]]}

    async def _set(self, request: Message) -> Message:
        reason = "the parameters of the bridge are read-only; switch rules by its REST interface or the page"
        return {"results": [{"successful": False, "reason": reason} for _ in request["parameters"]]}


def _parameter(value: Any) -> Message:
    if isinstance(value, bool):
        return {"type": _BOOL, "bool_value": value}
    if value is None:
        return {"type": _NOT_SET}
    return {"type": _STRING, "string_value": str(value)}
