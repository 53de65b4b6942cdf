"""Documents of clients that are stored: without null, and no document of one client fails for another.

A null has no meaning in a new document: a member that is not needed is left out. In a change it deletes a
member (clause 5.5.8). Elsewhere it is refused, because a value is needed there.

What is stored nevertheless, by an earlier version or by a fault of this one, is loaded one by one: a document
that cannot be used is reported with its id, and neither the start nor any request depends on it.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.model.problems import bad_request_data, conflict

log = get_logger(__name__)

_CONTEXTS: Final = frozenset({"@context", "context", "namesIn"})
"""Members with an @context, received and stored: JSON-LD has a meaning for null in it."""


def refuse_null(document: Any, what: str, *, deleting: int = 0) -> None:
    """Raise a problem (400) that names the first null in a document.

    A null in the first `deleting` levels of objects deletes a member, and is allowed.
    """
    path = next(_nulls(document, "", deleting), None)
    if path is not None:
        raise bad_request_data(f'"{path}" of {what} is null, and needs a value; leave it out')


def without_null(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return an object without null in it and in the objects directly in it, which means the same."""
    return {
        name: {inner: member for inner, member in value.items() if member is not None}
        if isinstance(value, Mapping) and name not in _CONTEXTS
        else value
        for name, value in document.items()
        if value is not None
    }


@contextmanager
def isolated(kind: str, tenant: str, document_id: str, unusable: dict[str, str]) -> Iterator[None]:
    """Load a stored document; if that fails, report it, and note it in `unusable` with the reason."""
    try:
        yield
    except Exception as error:  # whatever is wrong with one document, the others are used
        reason = error.detail if isinstance(error, Problem) else f"{type(error).__name__}: {error}"
        unusable[document_id] = reason
        log.exception(
            "a stored document cannot be used; delete it",
            kind=kind,
            tenant=tenant,
            document=document_id,
            reason=reason,
        )


def require_id(document_id: Any, stored_as: str) -> None:
    """Raise `ValueError` unless a stored document has the id under which it is stored."""
    if document_id != stored_as:
        raise ValueError(f"its id is {document_id!r}")


def unusable_document(document_type: str, document_id: str, reason: str) -> dict[str, Any]:
    """Return what clients see of a document that cannot be used."""
    return {"id": document_id, "type": document_type, "status": "failed", "reason": reason}


def is_unusable(what: str, document_id: str, reason: str) -> Problem:
    """A document that cannot be used cannot be changed."""
    return conflict(f"{what} {document_id} cannot be used ({reason}); delete it, and create it again")


def _nulls(value: Any, path: str, deleting: int) -> Iterator[str]:
    if isinstance(value, Mapping):
        for name, part in value.items():
            if name == "@context":
                continue
            inner = f"{path}.{name}" if path else str(name)
            if part is None:
                if not deleting:
                    yield inner
            else:
                yield from _nulls(part, inner, max(0, deleting - 1))
    elif isinstance(value, list):
        for number, part in enumerate(value):
            inner = f"{path}[{number}]"
            if part is None:
                yield inner
            else:
                yield from _nulls(part, inner, 0)
