"""REST routes of study conditions: whose gestures a participant of a study is asked for."""

from typing import Annotated, Any, Literal

from fastapi import FastAPI
from pydantic import Field

from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_gloves.people.study_conditions import StudyCondition
from handover_gloves.people.wearers import Wearers

Name = Annotated[str, Field(min_length=1, max_length=200)]
OWN, SITE = "own", "site"


class NewCondition(RequestBody):
    """A condition; `gestures` null: the usual ones. `participant` is a pseudonym for messages."""

    participant: Name
    glove: Name | None = None
    person: Name | None = None
    gestures: Literal["own", "site"] | None = None


def add_study_conditions(app: FastAPI, wearers: Wearers) -> None:
    """Add the routes of study conditions."""
    routes = TaggedRoutes(app, "study")

    @routes.get("/study-conditions", dependencies=[require(Permission.READ_STUDIES)])
    async def list_conditions() -> dict[str, dict[str, Any]]:
        """Return the conditions by study session."""
        return {session: _as_dict(condition) for session, condition in wearers.conditions.items()}

    @routes.put(
        "/study-conditions/{session}", status_code=204, dependencies=[require(Permission.CONDUCT_STUDIES)]
    )
    async def set_condition(session: str, new: NewCondition) -> None:
        """Ask a participant for the gestures of a condition from the next Task on, with any glove.

        The person wears the glove of the session from now on. The conditions of other sessions with the same
        glove or person end. Repeating a condition changes nothing.
        """
        own = None if new.gestures is None else new.gestures == OWN
        condition = StudyCondition(new.participant, new.glove, new.person, own)
        await wearers.apply_condition(session, condition)

    @routes.delete(
        "/study-conditions/{session}", status_code=204, dependencies=[require(Permission.CONDUCT_STUDIES)]
    )
    async def remove_condition(session: str) -> None:
        """End the condition of a session; a missing one is no error."""
        await wearers.end_condition(session)


def _as_dict(condition: StudyCondition) -> dict[str, Any]:
    return {
        "participant": condition.participant,
        "glove": condition.glove,
        "person": condition.person,
        "gestures": None if condition.own is None else OWN if condition.own else SITE,
    }
