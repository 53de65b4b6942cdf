"""Outcomes of the parts of one write, and the response to all of them (clause 6.3.17)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover.network.http_client import HttpResponse
from handover_broker.model.problems import ERRORS
from handover_broker.request.request_context import JSON, Response
from handover_federation.distribution.forwarding.forwarder import SourceError
from handover_federation.registrations.registration import Registration

_PASSED_ON: Final = frozenset({404, 409})
"""Failures of a single source that are returned to the client unchanged."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of one part: the broker's own (no registration) or a source's.

    `names` are its attributes (IRIs); `problem` is the failure, None for a success. `is_held`: the broker has
    the entity, so that its own 404 is about an attribute. `is_partial`: the source did another part (207).
    """

    registration: Registration | None
    names: frozenset[str]
    status: int
    problem: dict[str, Any] | None = None
    is_held: bool = False
    is_partial: bool = False

    @property
    def is_absence(self) -> bool:
        """Return whether the part had nothing to change and was not required to have anything."""
        if self.status != 404 or self.problem is None:
            return False
        return not self.is_held if self.registration is None else not self.registration.mode.is_proxied


def of_response(registration: Registration, names: frozenset[str], response: HttpResponse) -> Outcome:
    """Return the outcome of a source's response to a write that it does as a whole or not at all."""
    if 200 <= response.status < 300 and response.status != 207:
        return Outcome(registration, names, response.status)
    return Outcome(registration, names, response.status, problem_in(response, registration))


def of_parts(
    registration: Registration,
    names: frozenset[str],
    response: HttpResponse,
    entity_id: str,
    expand: Callable[[str], str],
) -> list[Outcome]:
    """Return the outcomes of a source's response to the write of one entity: those of its parts if it is 207.

    Such a response has the result for attributes (clause 5.2.18), whose names `expand` makes IRIs, or for
    entities (clause 5.2.16).
    """
    document = document_in(response) if response.status == 207 else None
    if isinstance(document, dict) and ("updated" in document or "notUpdated" in document):
        return _of_attributes(registration, names, document, expand)
    if isinstance(document, dict) and ("success" in document or "errors" in document):
        errors = [error for refused_id, error in errors_in(document) if refused_id in {entity_id, None}]
        is_done = entity_id in success_in(document)
        # Which attributes failed is unknown; where others were stored, they are not called failed.
        left = frozenset[str]() if is_done else names
        failed = [Outcome(registration, left, 207, error, is_partial=True) for error in errors]
        if is_done or failed:
            return [*([Outcome(registration, names, 204)] if is_done else []), *failed]
    return [of_response(registration, names, response)]


def _of_attributes(
    registration: Registration, names: frozenset[str], document: dict[str, Any], expand: Callable[[str], str]
) -> list[Outcome]:
    names_updated = document.get("updated")
    updated = (
        {expand(name) for name in names_updated if isinstance(name, str)}
        if isinstance(names_updated, list)
        else None
    )
    failed, left = list[Outcome](), set[str]()
    entries = document.get("notUpdated")
    for refusal in entries if isinstance(entries, list) else ():
        if not isinstance(refusal, dict) or not isinstance(refusal.get("attributeName"), str):
            continue
        name = expand(refusal["attributeName"])
        left.add(name)
        # Without a registration it is the state of the source that lets nothing change there.
        status = 207 if "registrationId" in refusal else 404
        detail = f"{registration.shown}: {refusal.get('reason') or 'not updated'}"
        problem = Problem(status, "Not updated", detail, ERRORS + "InternalError").body()
        failed.append(Outcome(registration, frozenset({name}), status, problem, is_partial=True))
    done = names - left if updated is None else names & updated
    if unnamed := names - done - left:
        detail = f"{registration.shown} says neither that it was updated nor why it was not"
        problem = Problem(502, "Bad gateway", detail, ERRORS + "InternalError").body()
        failed.append(Outcome(registration, unnamed, 502, problem, is_partial=True))
    return [*([Outcome(registration, done, 204)] if done else []), *failed]


def document_in(response: HttpResponse) -> Any:
    """Return the JSON document of a response; None without one."""
    try:
        return orjson.loads(response.body) if response.body else None
    except orjson.JSONDecodeError:
        return None


def errors_in(document: Any) -> list[tuple[str | None, dict[str, Any]]]:
    """Return the ids and the problems of the entities that a result of a batch says have failed."""
    errors = document.get("errors") if isinstance(document, dict) else None
    return [
        (error["entityId"] if isinstance(error.get("entityId"), str) else None, error["error"])
        for error in (errors if isinstance(errors, list) else ())
        if isinstance(error, dict) and isinstance(error.get("error"), dict)
    ]


def success_in(document: Any) -> list[str]:
    """Return the ids of the entities that a result of a batch says are done."""
    success = document.get("success") if isinstance(document, dict) else None
    return (
        [entity_id for entity_id in success if isinstance(entity_id, str)]
        if isinstance(success, list)
        else []
    )


def problem_in(response: HttpResponse, registration: Registration) -> dict[str, Any]:
    """Return the problem in a source's response, or one that describes the response."""
    document = document_in(response)
    if isinstance(document, dict) and isinstance(document.get("title"), str):
        return {**document, "status": response.status}
    detail = f"{registration.shown} returns {response.status}"
    if response.status == 207:
        detail = f"{registration.shown} succeeded in part: {response.body[:500].decode('utf-8', 'replace')}"
    return Problem(response.status, "Context source failed", detail, ERRORS + "InternalError").body()


def of_source_error(error: SourceError, names: frozenset[str]) -> Outcome:
    """Return the outcome of a part whose source gave no usable response."""
    title = {504: "Gateway timeout", 508: "Loop detected"}.get(error.status, "Bad gateway")
    kind = "LoopDetected" if error.status == 508 else "InternalError"
    problem = Problem(error.status, title, error.why, ERRORS + kind)
    return Outcome(error.registration, names, error.status, problem.body())


def of_refusal(registration: Registration, names: frozenset[str], operation: str) -> Outcome:
    """Return the outcome of a part whose source does not take the operation."""
    detail = (
        f"registration {registration.id} has this data exclusively and does not take {operation}; "
        "add the operation to it, or change the source directly"
    )
    return Outcome(registration, names, 409, Problem(409, "Conflict", detail, ERRORS + "Conflict").body())


def settled(outcomes: Iterable[Outcome]) -> tuple[list[Outcome], list[Outcome]]:
    """Return the successful outcomes and the failed ones to report.

    "Not found" is not reported if another part did the change.
    """
    everything = list(outcomes)
    good = [outcome for outcome in everything if outcome.problem is None]
    done = frozenset(name for outcome in good for name in outcome.names)
    elsewhere = bool(good) or any(
        outcome.problem is not None and not outcome.is_absence for outcome in everything
    )
    failed = [
        outcome
        for outcome in everything
        if outcome.problem is not None and not (outcome.is_absence and elsewhere and outcome.names <= done)
    ]
    return good, failed


def failure(failed: list[Outcome]) -> Response | None:
    """Return the response when every part failed; None if the parts failed in different ways, or one of
    them with a result for each attribute.

    A failure of the broker itself, on an entity that it has, comes first: AlreadyExists or ResourceNotFound
    (clauses 5.6.1.4 and 5.6.19.4), with the failures of the sources as "errors".
    """
    own = next(
        (outcome for outcome in failed if outcome.registration is None and not outcome.is_absence), None
    )
    if own is not None and own.problem is not None:
        others = [outcome.problem for outcome in failed if outcome is not own]
        return _problem_answer(own.status, {**own.problem, **({"errors": others} if others else {})}, None)
    statuses = {outcome.status for outcome in failed}
    if len(statuses) > 1 or any(outcome.is_partial for outcome in failed):
        return None
    first = failed[0]
    assert first.problem is not None  # noqa: S101 - it is a failure
    if first.registration is None or first.status in _PASSED_ON or first.status in {504, 508}:
        return _problem_answer(first.status, first.problem, first.registration)
    detail = f"{first.registration.shown} failed: {first.problem.get('detail') or first.status}"
    problem = Problem(502, "Bad gateway", detail, ERRORS + "InternalError").body()
    return _problem_answer(502, problem, first.registration)


def entity_result(entity_id: str, good: list[Outcome], failed: list[Outcome]) -> Response:
    """Return 207 with the outcomes of one entity (clause 5.2.16, BatchOperationResult)."""
    return multi_status({"success": [entity_id] if good else [], "errors": entity_errors(entity_id, failed)})


def entity_errors(entity_id: Any, failed: Iterable[Outcome]) -> list[dict[str, Any]]:
    """Return failures as errors of an entity (clause 5.2.17)."""
    return [
        {
            "entityId": entity_id,
            **({"registrationId": outcome.registration.id} if outcome.registration is not None else {}),
            "error": outcome.problem,
        }
        for outcome in failed
    ]


def multi_status(body: dict[str, Any]) -> Response:
    """Return 207 with a body."""
    return Response(207, orjson.dumps(body), [(b"content-type", JSON.encode())])


def _problem_answer(status: int, problem: dict[str, Any], registration: Registration | None) -> Response:
    body = {**problem, "status": status}
    if registration is not None:
        body["registrationId"] = registration.id
    return Response(status, orjson.dumps(body), [(b"content-type", JSON.encode())])
