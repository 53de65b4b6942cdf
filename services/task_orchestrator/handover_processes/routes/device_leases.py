"""Routes: the leases of Devices, for performers; `handover.tasks.device_lease` is their client."""

from typing import Annotated, Any

from fastapi import FastAPI, Request, Response
from pydantic import ConfigDict, Field
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.security.audit_trail import current_request
from handover.security.guard import authenticated, require, require_by_handler
from handover.security.permissions import Permission
from handover.tasks.device_lease import MAX_DEVICES_PER_REQUEST, PATH
from handover_processes.documents.document import json_response
from handover_processes.documents.requests import Plain
from handover_processes.operations.device_leases import LeaseAnswer
from handover_processes.running.components import Components
from handover_processes.storage.device_leases import LeaseHolder, StoredLease

MAX_LEASE_S = 60.0

Devices = Annotated[
    list[Annotated[str, Field(pattern=r"^urn:[^\x00\s]+$", max_length=2000)]],
    Field(min_length=1, max_length=MAX_DEVICES_PER_REQUEST, description="the ids of Devices or Persons"),
]


class _Body(StrictModel):
    model_config = ConfigDict(extra="forbid", alias_generator=to_camel, populate_by_name=True)


class LeaseRelease(_Body):
    """Leases that a performer gives back."""

    holder: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00]*$")]
    session: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00]*$")]
    devices: Devices


class LeaseRequest(LeaseRelease):
    """The leases that a performer wants or has.

    `holder` is its durable identity: a new `session` of it replaces the one before.
    """

    performer: Plain
    host: Plain
    pid: int = Field(ge=0, lt=2**31)
    duration_s: float = Field(ge=1, le=MAX_LEASE_S)


class HolderView(_Body):
    """A process that has a lease."""

    performer: str
    host: str
    pid: int
    since: str


class LeaseView(_Body):
    """The lease of a Device; `number` grows with each grant."""

    device: str
    number: int
    ends_in_s: float
    holder: HolderView


class LeaseAnswerView(LeaseView):
    """The answer to a request: whether the lease was granted, else who has it."""

    granted: bool


class LeaseAnswers(_Body):
    """The answers for all Devices of a request."""

    leases: list[LeaseAnswerView]


def add_device_leases(app: FastAPI, at: Components) -> None:
    """Add the routes."""
    routes = TaggedRoutes(app, "device leases")

    async def require_devices(connection: Request, devices: list[str]) -> None:
        caller = await authenticated(connection)
        for device in devices:
            at.guard.require(caller, Permission.WRITE_ENTITIES, device)

    @routes.get(PATH, dependencies=[require(Permission.READ)])
    async def device_leases() -> list[LeaseView]:
        """Return the last lease of each Device; `endsInS` is 0 if nobody has it now."""
        return [LeaseView(**_lease(lease, ends_in_s)) for lease, ends_in_s in at.orchestrator.leases.all()]

    @routes.post(
        PATH,
        responses={200: {"model": LeaseAnswers}},
        dependencies=[require_by_handler(Permission.WRITE_ENTITIES, "for each of the Devices")],
    )
    async def acquire(body: LeaseRequest, connection: Request) -> Response:
        """Get or renew the leases of Devices: each is granted unless another holder has it."""
        await require_devices(connection, body.devices)
        holder = LeaseHolder(body.holder, body.session, body.performer, body.host, body.pid)
        devices = list(dict.fromkeys(body.devices))
        answers = await at.orchestrator.leases.acquire(devices, holder, body.duration_s)
        act = current_request()
        if act is not None and not any(answer.is_new for answer in answers):
            act.is_recorded = True  # a renewal changes nothing
        return json_response({"leases": [_answer(answer) for answer in answers]})

    @routes.post(
        f"{PATH}/release",
        status_code=204,
        dependencies=[require_by_handler(Permission.WRITE_ENTITIES, "for each of the Devices")],
    )
    async def release(body: LeaseRelease, connection: Request) -> Response:
        """Give leases back, so that another performer gets them at once."""
        await require_devices(connection, body.devices)
        await at.orchestrator.leases.release(body.devices, body.holder, body.session)
        return Response(status_code=204)


def _lease(lease: StoredLease, ends_in_s: float) -> dict[str, Any]:
    holder = lease.holder
    return {
        "device": lease.device,
        "number": lease.number,
        "endsInS": round(ends_in_s, 3),
        "holder": {
            "performer": holder.performer,
            "host": holder.host,
            "pid": holder.pid,
            "since": lease.since,
        },
    }


def _answer(answer: LeaseAnswer) -> dict[str, Any]:
    return {**_lease(answer.lease, answer.ends_in_s), "granted": answer.is_granted}
