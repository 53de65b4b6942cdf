"""Parts of the broker that another package brings, with an entry point in `handover.broker_plugins`.

    [project.entry-points."handover.broker_plugins"]
    federation = "handover_federation.broker_federation:BrokerFederation"

The broker knows the names of two: `federation`, which makes a `Federation`, and `snapshots`, which makes
`Snapshots`. Without a plugin the operations of its part answer 422 OperationNotSupported, and what they have
stored is kept.
"""

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from handover.distribution import install_part
from handover.errors import UsageError
from handover.extensions import ExtensionPoint
from handover.telemetry import get_logger
from handover_broker.model.problems import not_supported
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal

log = get_logger(__name__)

PLUGINS: Final = ExtensionPoint(
    "broker plugin",
    "handover.broker_plugins",
    parts={"federation": "handover-federation", "snapshots": "handover-federation"},
)
"""The plugins that are installed; each entry point is a function or class that makes the part."""

PerformByName = Callable[[str, RequestContext], Awaitable[Response]]
"""Carries out the operation of a name, context sources included."""
CarryOut = Callable[[Operation, RequestContext], Awaitable[Response]]

ListedOperation = tuple[str, str, str, str]
"""Method, path, name and clause of an operation."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """A part that is optional: the name of its entry point, what it adds, and its setting."""

    name: str
    content: str
    setting: str

    def factory(self, *, is_wanted: bool | None) -> Any:
        """Return what makes the part; None without it. `is_wanted` None means: if a package brings it.

        Raises `UsageError` if it is broken, or wanted and not installed.
        """
        if is_wanted and self.name not in PLUGINS.names():
            raise UsageError(
                f"{self.setting}=true needs a plugin that is not installed: "
                f"{install_part(PLUGINS.parts[self.name])}; without the setting the broker runs without "
                f"{self.content}"
            )
        factories = PLUGINS.load_registered((self.name,)) if is_wanted is not False else []
        return factories[0] if factories else None

    def missing(self) -> str:
        """Return why an operation is refused without the plugin, and the way out."""
        way_out = f"start it with {self.setting}=true to use them"
        if self.name not in PLUGINS.names():
            way_out = f"install the plugin, and start it again: {install_part(PLUGINS.parts[self.name])}"
        return f"this broker runs without {self.content}; {way_out}"


class _AnyParameter(frozenset[str]):
    """All query parameters: the request is refused for the operation, not for its parameters."""

    def __contains__(self, name: object) -> bool:
        return True


def unsupported(listed: Iterable[ListedOperation], detail: str) -> tuple[Operation, ...]:
    """Return the operations as ones that are refused with `detail`, whatever their parameters are."""

    async def refuse(request: RequestContext) -> Response:  # noqa: ARG001 - as all operations
        raise not_supported(detail)

    return tuple(Operation(*operation, refuse, _AnyParameter(), of_no_tenant=True) for operation in listed)


def warn_of_stored(journal: Journal, kind: DocumentKind, plugin: Plugin) -> None:
    """Log a warning if the database has documents of a part that is missing; they stay stored."""
    if count := sum(1 for _ in journal.documents(kind)):
        log.warning("stored documents are ignored", kind=kind.value, count=count, setting=plugin.setting)
