"""Routes: definitions of other systems, offered for deployment."""

from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY
from handover_processes.documents.document import json_response
from handover_processes.documents.offers import OfferView
from handover_processes.documents.requests import OfferRequest
from handover_processes.operations.offering import OfferReader
from handover_processes.records.offers import OfferStatus
from handover_processes.routes.resources import acting_name
from handover_processes.running.components import Components

OFFER: dict[int | str, dict[str, Any]] = {200: {"model": OfferView}}


def add_offers(app: FastAPI, at: Components) -> None:
    """Add the routes of offers."""
    routes = TaggedRoutes(app, "offers")
    orchestrator = at.orchestrator
    reader = OfferReader(orchestrator.state, orchestrator.offering)

    @routes.get(
        "/offers", responses={200: {"model": list[OfferView]}}, dependencies=[require(Permission.READ)]
    )
    async def offers(
        *,
        status: OfferStatus | None = None,
        entity: Annotated[str | None, Query(max_length=2000, description="the id of the entity")] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    ) -> Response:
        """Return definitions that other systems have written to the broker, the latest first."""
        records = orchestrator.state.offers.listed(status, entity)[:limit]
        return json_response([await reader.view(record) for record in records])

    @routes.get("/offers/{offer}", responses=OFFER, dependencies=[require(Permission.READ)])
    async def offer(offer: str) -> Response:
        """Return an offer with its faults, what its acceptance would change, and who would get the work."""
        return json_response(await reader.view(orchestrator.offering.require(offer)))

    @routes.get(
        "/offers/{offer}/bpmn",
        response_class=Response,
        responses=sends("application/xml"),
        dependencies=[require(Permission.READ)],
    )
    async def bpmn(offer: str) -> Response:
        """Return the BPMN file of an offer, as it was read when the offer was made."""
        orchestrator.offering.require(offer)
        xml = await orchestrator.on_disk(orchestrator.store.offer_file, offer)
        if xml is None:
            raise Problem.translated(404, "No file", "offer.no_file", "the offer has no BPMN file")
        return Response(xml, media_type="application/xml")

    @routes.post(
        "/offers/{offer}/accept", responses=OFFER, dependencies=[require(Permission.DEPLOY_PROCESSES)]
    )
    async def accept(offer: str, body: OfferRequest) -> Response:
        """Deploy what is offered; it takes effect for Tasks that are posted later."""
        return json_response(
            await reader.view(await at.offers.accept(offer, by=acting_name(body.by), why=body.why))
        )

    @routes.post(
        "/offers/{offer}/reject", responses=OFFER, dependencies=[require(Permission.DEPLOY_PROCESSES)]
    )
    async def reject(offer: str, body: OfferRequest) -> Response:
        """Reject an offer: the same content of the entity is not offered again."""
        return json_response(
            await reader.view(await at.offers.reject(offer, by=acting_name(body.by), why=body.why))
        )

    @app.post(
        "/notifications/definitions",
        status_code=204,
        tags=["notifications"],
        dependencies=[REQUIRES_NOTIFICATION_KEY],
    )
    async def notify(request: Request) -> Response:
        """Read the definitions of a notification from the broker soon."""
        await at.offers.receive_notification(request)
        return Response(status_code=204)
