"""Problems: the error types of NGSI-LD, with the way out.

ETSI GS CIM 009, clause 5.5.2 and table 6.3.2-1.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from handover.errors import Problem

ERRORS = "https://uri.etsi.org/ngsi-ld/errors/"


def bad_request_data(detail: str) -> Problem:
    """The document is valid JSON, but not valid NGSI-LD."""
    return Problem(400, "Bad request data", detail, ERRORS + "BadRequestData")


def invalid_request(detail: str) -> Problem:
    """The request is malformed: broken JSON, wrong parameters."""
    return Problem(400, "Invalid request", detail, ERRORS + "InvalidRequest")


def already_exists(detail: str) -> Problem:
    """The id is in use."""
    return Problem(409, "Already exists", detail, ERRORS + "AlreadyExists")


def conflict(detail: str) -> Problem:
    """The request conflicts with the present state."""
    return Problem(409, "Conflict", detail, ERRORS + "Conflict")


def not_found(detail: str) -> Problem:
    """There is no resource with this id."""
    return Problem(404, "Not found", detail, ERRORS + "ResourceNotFound")


def no_such_tenant(detail: str) -> Problem:
    """The tenant is unknown."""
    return Problem(404, "No such tenant", detail, ERRORS + "NonexistentTenant")


def not_supported(detail: str) -> Problem:
    """NGSI-LD has the operation, this broker does not."""
    return Problem(422, "Operation not supported", detail, ERRORS + "OperationNotSupported")


def too_many_results(detail: str) -> Problem:
    """The result is larger than the broker returns."""
    return Problem(403, "Too many results", detail, ERRORS + "TooManyResults")


def context_not_available(detail: str) -> Problem:
    """An @context cannot be loaded."""
    return Problem(504, "Context not available", detail, ERRORS + "LdContextNotAvailable")


def unsupported_media_type(detail: str) -> Problem:
    """The media type of the body is not supported."""
    return Problem(415, "Unsupported media type", detail, ERRORS + "InvalidRequest")


def not_acceptable(detail: str, offered: Iterable[str]) -> Problem:
    """No accepted media type is available; `offered` are those that are.

    They are listed in the body (clause 6.3.4).
    """
    listed = {"availableRepresentations": [*offered]}
    return Problem(406, "Not acceptable", detail, ERRORS + "InvalidRequest", listed)


def too_large(detail: str) -> Problem:
    """The body is larger than the limit."""
    return Problem(413, "Content too large", detail, ERRORS + "InvalidRequest")


@dataclass
class MethodNotAllowed(Problem):
    """The path exists, the method does not; `allowed` are the methods of the path."""

    allowed: tuple[str, ...] = ()


def method_not_allowed(detail: str, allowed: Iterable[str]) -> Problem:
    """The path exists, the method does not."""
    kind = ERRORS + "OperationNotSupported"
    return MethodNotAllowed(405, "Method not allowed", detail, kind, allowed=tuple(allowed))


def length_required() -> Problem:
    """The body has no length; the response has no body (clause 6.3.4)."""
    return Problem(411, "Length required", "send a Content-Length", ERRORS + "InvalidRequest")


def not_stored(reason: str, *, is_away: bool = False) -> Problem:
    """The disk refused the change, or the database `is_away`; nothing of it is stored."""
    if is_away:
        detail = f"the change was not stored: {reason}; try again in a moment"
        return Problem(503, "Service unavailable", detail, ERRORS + "InternalError")
    detail = f"the change was not stored: {reason}; try again once there is space"
    return Problem(507, "Insufficient storage", detail, ERRORS + "InternalError")


def is_standby(reason: str) -> Problem:
    """Another broker writes the database; this one serves when that one ends."""
    detail = f"this broker is a standby: {reason}; send the request to the other broker, or again in a moment"
    return Problem(503, "Service unavailable", detail, ERRORS + "InternalError")


def not_read(reason: str) -> Problem:
    """The database cannot be read."""
    detail = f"the database cannot be read at the moment: {reason}; try again"
    return Problem(503, "Service unavailable", detail, ERRORS + "InternalError")


def went_wrong(error: Exception, doing: str) -> Problem:
    """An unexpected error; the log has the details."""
    reason = f"{type(error).__name__} while {doing}; see the log of the broker"
    return Problem(500, "Internal error", reason, ERRORS + "InternalError")
