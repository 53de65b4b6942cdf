"""Answers of a broker: the errors for refusals, and what a partial success left out."""

from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final, TypeVar

import orjson

from handover.broker.credentials import HOW_TO_SET
from handover.broker.errors import AlreadyExists, BrokerError, BrokerFault, BrokerUnavailable, NotFound
from handover.network.http_client import HttpResponse

NgsiLd = Mapping[str, Any]
AJson = TypeVar("AJson", list[Any], dict[str, Any])

TRANSIENT: Final = frozenset(
    {
        HTTPStatus.REQUEST_TIMEOUT,
        HTTPStatus.TOO_EARLY,
        HTTPStatus.TOO_MANY_REQUESTS,
        HTTPStatus.BAD_GATEWAY,
        HTTPStatus.SERVICE_UNAVAILABLE,
        HTTPStatus.GATEWAY_TIMEOUT,
        HTTPStatus.INSUFFICIENT_STORAGE,
    }
)
"""Refusals that concern the moment and not the request."""
_FINAL: Final = frozenset({HTTPStatus.NOT_IMPLEMENTED, HTTPStatus.HTTP_VERSION_NOT_SUPPORTED})
"""Those above 500 that concern the request: the broker will never perform it."""


def refusal_of(response: HttpResponse, act: str) -> BrokerError:
    """Return the error for an answer that is no success."""
    try:
        problem = orjson.loads(response.body)
    except orjson.JSONDecodeError:
        problem = {}
    if not isinstance(problem, dict):
        problem = {}
    status = response.status
    if 300 <= status < 400:
        return BrokerUnavailable(
            status,
            "Redirected",
            f"the broker redirects to {response.headers.get('location', 'nowhere')}, perhaps to sign in: "
            f"set HANDOVER_BROKER_URL to the broker itself; where it wants credentials, {HOW_TO_SET} ({act})",
        )
    title = str(problem.get("title") or _phrase(status))
    detail = str(problem.get("detail") or response.body.decode(errors="replace")[:500])
    kind = str(problem.get("type", "about:blank"))
    return error_class(status)(status, title, f"{detail} ({act})", kind)


def error_class(status: int) -> type[BrokerError]:
    """Return the error for a status."""
    if status == HTTPStatus.NOT_FOUND:
        return NotFound
    if status == HTTPStatus.CONFLICT:
        return AlreadyExists
    if status in TRANSIENT:
        return BrokerUnavailable
    is_fault = status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _FINAL
    return BrokerFault if is_fault else BrokerError


def finds_nothing(method: str, path: str, params: Mapping[str, Any] | None, response: HttpResponse) -> bool:
    """Return whether a query of entities has no result."""
    if method != "GET" or path != "/entities" or params is None:
        return False
    if params.get("limit") == 0:
        return response.headers.get("ngsild-results-count") == "0"
    return not params.get("offset") and response.body.strip() == b"[]"


def document_of(response: HttpResponse, kind: type[AJson], url: str) -> AJson:
    """Return the body as a JSON list or object. Raises `BrokerUnavailable`."""
    try:
        document = orjson.loads(response.body)
    except orjson.JSONDecodeError:
        document = None
    if not isinstance(document, kind):
        raise no_broker(response, url)
    return document


def no_broker(response: HttpResponse, url: str) -> BrokerUnavailable:
    """Return the error for an answer that no NGSI-LD broker gives."""
    return BrokerUnavailable(
        502,
        "No answer of a broker",
        f"{url} answers {response.status} with {response.headers.get('content-type', 'no type')}, which is "
        "no NGSI-LD: perhaps a sign-in page, a proxy, another server; set HANDOVER_BROKER_URL to the broker",
    )


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return f"Status {status}"


def require_all_done(
    answer: HttpResponse,
    undone: str,
    describe: Callable[[NgsiLd], str],
    *,
    is_ignored: Callable[[NgsiLd], bool] = lambda _: False,
) -> None:
    """Raise `BrokerError` for the failures in the list `undone` of a partial success.

    Failures for which `is_ignored` is true are ignored.
    """
    failures = [failure for failure in failures_of(answer, undone) if not is_ignored(failure)]
    if failures:
        raise _refused_in_part(failures, describe)


def failures_of(answer: HttpResponse, undone: str) -> list[NgsiLd]:
    """Return what a partial success left out: the list `undone`."""
    if answer.status != HTTPStatus.MULTI_STATUS:
        return []
    return list(orjson.loads(answer.body).get(undone, []))


def _refused_in_part(failures: Sequence[NgsiLd], describe: Callable[[NgsiLd], str]) -> BrokerError:
    """Return `BrokerUnavailable` if one of the failures concerns the moment: all may be sent again."""
    text = "; ".join(map(describe, failures))
    statuses = {error_class(status): status for status in map(_status_of, failures)}
    for kind in (BrokerUnavailable, BrokerFault):
        if kind in statuses:
            return kind(statuses[kind], "Unavailable in part", text)
    return BrokerError(400, "Refused in part", text)


def _status_of(error: Mapping[str, Any]) -> int:
    problem = error.get("error")
    status = problem.get("status") if isinstance(problem, Mapping) else None
    return int(status) if isinstance(status, int | str) and str(status).isdecimal() else 0


def refused_ids(answer: HttpResponse) -> frozenset[str]:
    """Return the ids of the entities that a batch operation refused; raise `BrokerError` if one has no id."""
    errors = failures_of(answer, "errors")
    if not all(isinstance(error.get("entityId"), str) for error in errors):
        raise _refused_in_part(errors, batch_error)
    return frozenset(error["entityId"] for error in errors)


def is_not_found(error: Mapping[str, Any]) -> bool:
    """Return whether an error of a batch says that there is no such entity."""
    problem = error.get("error")
    if not isinstance(problem, Mapping):
        return False
    named = str(problem.get("type", "")).endswith("/ResourceNotFound")
    return named or _status_of(error) == HTTPStatus.NOT_FOUND


def not_updated(left: Mapping[str, Any]) -> str:
    """Describe attributes that were not updated, in the form of the standard or of Orion-LD."""
    names = left.get("attributeName") or ", ".join(map(str, left.get("attributes") or ()))
    return f"{names}: {left.get('reason') or left.get('title')}"


def batch_error(error: Mapping[str, Any]) -> str:
    """Describe an error of a batch."""
    problem = error.get("error", {})
    reason = problem.get("detail") or problem.get("title") if isinstance(problem, Mapping) else problem
    return f"{error.get('entityId')}: {reason}"
