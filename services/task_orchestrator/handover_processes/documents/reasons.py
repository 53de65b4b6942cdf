"""Reasons: texts for people that say why something is so."""

from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict

from handover_processes.documents.document import Coded


class Reason(TypedDict):
    """A reason; the page translates it by its code and parameters."""

    reason: Annotated[str | None, Coded()]
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]


class KnownReason(TypedDict):
    """A reason that is never absent."""

    reason: Annotated[str, Coded()]
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]


class Allocated(TypedDict):
    """The reason why the performer of a Task was chosen."""

    allocated: Annotated[str | None, Coded()]
    allocatedCode: NotRequired[str]
    allocatedParameters: NotRequired[dict[str, Any]]
