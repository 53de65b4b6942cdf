"""Delete a Person everywhere: each service deletes what it has, and the answer says what remains and why.

The services are asked with the credentials of the caller, and each requires `managePeople` for the Person. A
service that does not answer keeps its part; the deletion can be repeated with the same name.
"""

from collections.abc import Awaitable, Callable, Mapping
from typing import Annotated, Any, Final, Literal
from urllib.parse import quote

import httpx
from fastapi import FastAPI, Request
from fastapi import Path as InPath
from typing_extensions import TypedDict

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.messages import message, with_code
from handover.security.guard import guard_of, in_path, require
from handover.security.permissions import Permission

PATHS: Final = {
    "study": "persons/{person}",
    "gesture-controller": "people/{person}",
    "human-state": "people/{person}",
    "whole-body-control": "persons/{person}",
}
"""The route that deletes what a service knows of a person. Studies first: while one uses the gestures of the
person, these cannot be deleted."""
TIMEOUT_S: Final = 30.0

Name = Annotated[str, InPath(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
HeadersOf = Callable[[Request, bool], Awaitable[Mapping[str, str]]]
Outcome = Literal["deleted", "nothing", "refused", "unreachable"]


class RemovedPart(TypedDict):
    """What became of the data of one service, with its `detail` if it remains."""

    service: str
    outcome: Outcome
    detail: str | None


class RemovedPerson(TypedDict):
    """The parts of all services, and what remains everywhere: `why`, with `whyCode` and `whyParameters`."""

    person: str
    parts: list[RemovedPart]
    remains: list[dict[str, Any]]


class PersonRemoval:
    """Asks the services by `http`, which sends no credentials of its own to them when it is given some."""

    def __init__(
        self, urls: Mapping[str, str], http: httpx.AsyncClient, broker: BrokerClient, headers_of: HeadersOf
    ) -> None:
        self._urls, self._http, self._broker, self._headers_of = urls, http, broker, headers_of

    async def remove(self, name: str, person: str, request: Request) -> RemovedPerson:
        """Delete the person `name` with the entity id `person`."""
        headers = await self._headers_of(request, False)
        parts = [
            await self._part(service, path.format(person=quote(name, safe="")), headers)
            for service, path in PATHS.items()
        ]
        parts.append(await self._entity(person))
        return {"person": person, "parts": parts, "remains": [with_code("why", why) for why in _remains()]}

    async def _part(self, service: str, path: str, headers: Mapping[str, str]) -> RemovedPart:
        try:
            answer = await self._http.request(
                "DELETE", f"{self._urls[service]}/{path}", headers=headers, auth=None, timeout=TIMEOUT_S
            )
        except httpx.HTTPError as error:
            return _unreachable(service, error)
        return _part_of(service, answer)

    async def _entity(self, person: str) -> RemovedPart:
        outcome: Outcome = "deleted"
        detail = None
        try:
            await self._broker.delete(person)
        except NotFound:
            outcome = "nothing"
        except BrokerError as error:
            outcome, detail = "unreachable", str(error.detail)
        return {"service": "context-broker", "outcome": outcome, "detail": detail}


def add_person_removal(app: FastAPI, removal: PersonRemoval) -> None:
    """Add the route."""
    allowed = require(Permission.MANAGE_PEOPLE, in_path("Person", "person"))

    @app.delete("/api/persons/{person}", tags=["people"], dependencies=[allowed])
    async def remove(person: Name, request: Request) -> RemovedPerson:
        """Delete a Person with gestures, body signals, sessions and studies; return what remains and why."""
        return await removal.remove(person, guard_of(request).settings.entity_id("Person", person), request)


def _part_of(service: str, answer: httpx.Response) -> RemovedPart:
    if answer.is_success or answer.status_code == httpx.codes.NOT_FOUND:
        return {"service": service, "outcome": "deleted" if answer.is_success else "nothing", "detail": None}
    try:
        detail = str(answer.json().get("detail") or answer.status_code)
    except ValueError:
        detail = str(answer.status_code)
    return {"service": service, "outcome": "refused", "detail": detail[:500]}


def _unreachable(service: str, error: httpx.HTTPError) -> RemovedPart:
    return {"service": service, "outcome": "unreachable", "detail": str(error) or type(error).__name__}


def _remains() -> tuple[str, ...]:
    return (
        message(
            "person.tasks_remain",
            "Tasks and processes that were performed keep the id of the Person as who performed them: they "
            "are the record of the work, and are deleted with it.",
        ),
        message(
            "person.audit_remains",
            "Audit records keep a random alias in place of the Person, so that nobody can change them "
            "unnoticed; they expire after their retention.",
        ),
        message(
            "person.backups_remain", "Backups and exported files are outside of Handover; delete them there."
        ),
    )
