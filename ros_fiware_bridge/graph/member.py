"""A member of a graph: what every way to a ROS graph keeps of its node, its names and what it has opened."""

from typing import Any

from ros_fiware_bridge.errors import GraphClosed, MessageTooBig
from ros_fiware_bridge.graph import names
from ros_fiware_bridge.graph.joining import JoinSettings
from ros_fiware_bridge.types.type_store import TypeStore


class Member:
    """What the adapters have in common; they do the rest of `port.RosGraph`."""

    def __init__(self, store: TypeStore, settings: JoinSettings) -> None:
        self.store = store
        self.node_name = names.full_name(settings.node, settings.namespace, settings.node)
        self._settings = settings
        self._opened: dict[int, Any] = {}
        self._closed = False

    def _full(self, name: str) -> str:
        if self._closed:
            raise GraphClosed(f"{name}: the graph was closed")
        return names.full_name(name, self._settings.namespace, self._settings.node)

    def _type(self, type_name: str, kind: str, *parts: str) -> str:
        full = self.store.resolve(type_name, kind)
        for part in parts:
            self.store.sound(f"{full}{part}")
        return full

    def _keep(self, opened: Any) -> None:
        self._opened[id(opened)] = opened

    def _gone(self, opened: Any) -> None:
        self._opened.pop(id(opened), None)

    async def _close_all(self) -> None:
        """Close what is open, the last first: it stands on what was opened before it."""
        for opened in reversed(list(self._opened.values())):
            await opened.close()


def require_fit(where: str, size: int, most_bytes: int) -> None:
    """Raise `MessageTooBig` for a message of `size` bytes that is to go to `where`."""
    if size > most_bytes:
        raise MessageTooBig(
            f"{where}: a message of {size} bytes is too big, {most_bytes} are allowed; "
            "raise the limit if it is meant"
        )
