"""What the broker answers when it cannot do as asked: the error types of NGSI-LD, with the way out.

ETSI GS CIM 009, clause 5.5.2 and table 6.3.2-1.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from handover.errors import Problem

ERRORS = "https://uri.etsi.org/ngsi-ld/errors/"


def bad_request_data(detail: str) -> Problem:
    """The document can be read, but does not say what NGSI-LD allows."""
    return Problem(400, "Bad request data", detail, ERRORS + "BadRequestData")


def invalid_request(detail: str) -> Problem:
    """The request cannot be read: broken JSON, wrong parameters."""
    return Problem(400, "Invalid request", detail, ERRORS + "InvalidRequest")


def already_exists(detail: str) -> Problem:
    """The id is taken."""
    return Problem(409, "Already exists", detail, ERRORS + "AlreadyExists")


def conflict(detail: str) -> Problem:
    """What is asked for cannot be together with what is there."""
    return Problem(409, "Conflict", detail, ERRORS + "Conflict")


def not_found(detail: str) -> Problem:
    """There is nothing with this id."""
    return Problem(404, "Not found", detail, ERRORS + "ResourceNotFound")


def no_such_tenant(detail: str) -> Problem:
    """The tenant is not known."""
    return Problem(404, "No such tenant", detail, ERRORS + "NonexistentTenant")


def not_supported(detail: str) -> Problem:
    """NGSI-LD has it, this broker does not."""
    return Problem(422, "Operation not supported", detail, ERRORS + "OperationNotSupported")


def too_many_results(detail: str) -> Problem:
    """More was asked for at once than the broker gives."""
    return Problem(403, "Too many results", detail, ERRORS + "TooManyResults")


def context_not_available(detail: str) -> Problem:
    """An @context cannot be loaded."""
    return Problem(504, "Context not available", detail, ERRORS + "LdContextNotAvailable")


def unsupported_media_type(detail: str) -> Problem:
    """The body is in a format that the broker does not read."""
    return Problem(415, "Unsupported media type", detail, ERRORS + "InvalidRequest")


def not_acceptable(detail: str, offered: Iterable[str]) -> Problem:
    """The answer is wanted in a format that the broker does not write; `offered` are those it writes.

    They are listed in the body, as clause 6.3.4 has it.
    """
    listed = {"availableRepresentations": [*offered]}
    return Problem(406, "Not acceptable", detail, ERRORS + "InvalidRequest", listed)


def too_large(detail: str) -> Problem:
    """The body is larger than the broker reads."""
    return Problem(413, "Content too large", detail, ERRORS + "InvalidRequest")


@dataclass
class MethodNotAllowed(Problem):
    """The path is right, the method is not; `allowed` are those that the path takes."""

    allowed: tuple[str, ...] = ()


def method_not_allowed(detail: str, allowed: Iterable[str]) -> Problem:
    """The path is right, the method is not."""
    kind = ERRORS + "OperationNotSupported"
    return MethodNotAllowed(405, "Method not allowed", detail, kind, allowed=tuple(allowed))


def length_required() -> Problem:
    """A body has no length; the answer has no body (clause 6.3.4)."""
    return Problem(411, "Length required", "send a Content-Length", ERRORS + "InvalidRequest")


def not_stored(reason: str) -> Problem:
    """The disk did not take the change; nothing of it is kept."""
    detail = f"the change was not stored and nothing of it is kept: {reason}; try again once there is space"
    return Problem(507, "Insufficient storage", detail, ERRORS + "InternalError")


def is_standby(reason: str) -> Problem:
    """Another broker writes the database; this one serves when that one ends."""
    detail = f"this broker is a standby: {reason}; send the request to the other broker, or again in a moment"
    return Problem(503, "Service unavailable", detail, ERRORS + "InternalError")


def not_read(reason: str) -> Problem:
    """The database did not tell what was asked for."""
    detail = f"what was asked for cannot be read just now: {reason}; try again in a moment"
    return Problem(503, "Service unavailable", detail, ERRORS + "InternalError")


def went_wrong(error: Exception, doing: str) -> Problem:
    """Something failed that should not have; what it was stands in the log."""
    reason = f"{type(error).__name__} while {doing}; the log of the broker has more"
    return Problem(500, "Internal error", reason, ERRORS + "InternalError")
