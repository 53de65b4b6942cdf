"""The base class of the adapters: names, types and open endpoints of a graph."""

from typing import Any

from handover_ros.errors import GraphClosed, MessageTooBig
from handover_ros.graph import names
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.own_goals import OwnGoals
from handover_ros.types.type_store import TypeStore


class BaseGraph:
    """The common part of the adapters; subclasses implement `port.RosGraph`."""

    def __init__(self, store: TypeStore, settings: JoinSettings) -> None:
        self.store = store
        self.node_name = names.full_name(settings.node, settings.namespace, settings.node)
        self.goals = OwnGoals(settings.goals_file)
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

    def _register(self, opened: Any) -> None:
        self._opened[id(opened)] = opened

    def _unregister(self, opened: Any) -> None:
        self._opened.pop(id(opened), None)

    async def _close_all(self) -> None:
        """Close everything that is open, in reverse order: later endpoints may use earlier ones."""
        for opened in reversed(list(self._opened.values())):
            await opened.close()


def require_fit(where: str, size: int, max_message_bytes: int) -> None:
    """Raise `MessageTooBig` if a message of `size` bytes for `where` is over the limit."""
    if size > max_message_bytes:
        raise MessageTooBig(
            f"{where}: a message of {size} bytes is too big, {max_message_bytes} are allowed; "
            "raise the limit if such messages are expected"
        )
