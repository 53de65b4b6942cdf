"""REST of the gestures of the site."""

from typing import cast

from fastapi import FastAPI

from handover.security.guard import require, require_somewhere
from handover.security.permissions import Permission
from handover_gloves.controller import GestureController
from handover_gloves.recognition.gesture_views import CompositeSiteGesture, PlainSiteGesture
from handover_gloves.recognition.gestures import listed
from handover_gloves.routes.pictures import picture_urls


def add_gestures(app: FastAPI, controller: GestureController) -> None:
    """Add the gestures of the site, and the state of the specifications."""

    @app.get("/gestures", tags=["gestures"], dependencies=[require_somewhere(Permission.READ)])
    async def gestures() -> list[PlainSiteGesture | CompositeSiteGesture]:
        """List the gestures of the site: name, code (thumb first, 0 straight, 2 bent), command and pictures.

        A composite gesture has no code but `left` and `right`, or `sequence`; each part has its code.
        """
        gestures_of_site = listed(controller.configuration.gestures, controller.configuration.commands)
        return [
            cast(
                "PlainSiteGesture | CompositeSiteGesture",
                {**gesture, "pictures": picture_urls(gesture["name"])},
            )
            for gesture in gestures_of_site
        ]

    @app.get("/specifications", tags=["operations"], dependencies=[require(Permission.READ)])
    async def specifications() -> dict[str, str]:
        """Return the URL and the state of the database for TaskDefinitions that the broker does not have."""
        database = controller.specifications
        return {
            "database": database.shown,
            "state": database.state.name,
            "detail": database.state.detail,
        }
