"""People in answers, and what the routes of people share."""

from dataclasses import dataclass
from typing import Annotated, Any, cast

from pydantic import Field

from handover.security.guard import in_path
from handover_gloves.calibration.glove_records import GloveRecords
from handover_gloves.calibration.glove_store import Fit
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.people.people import People
from handover_gloves.people.person import OwnGesture
from handover_gloves.people.views import FitView, OwnGestureView, PersonView, Side
from handover_gloves.people.wearers import Wearers

Name = Annotated[str, Field(min_length=1, max_length=100)]
GestureName = Annotated[str, Field(min_length=1, max_length=100)]

of_person = in_path("Person", "person")


@dataclass(frozen=True, slots=True)
class PeopleParts:
    """What the routes of people share."""

    wearers: Wearers
    gloves: KnownGloves
    records: GloveRecords

    @property
    def people(self) -> People:
        """All people."""
        return self.wearers.people

    def require_no_study(self, person: str) -> None:
        """Raise `Problem` while the person takes part in a study."""
        self.wearers.conditions.require_none(person=person)


def person_view(name: str, parts: PeopleParts) -> PersonView:
    """Return a person as in answers."""
    person = parts.people.named(name)
    commands = parts.people.commands_of(name)
    return {
        "name": person.name,
        "title": person.title,
        "gloves": [
            {"glove": glove.name, "hand": cast("Side", glove.hand), "connected": glove.is_connected}
            for glove in parts.gloves.worn_by(name)
        ],
        "fits": {glove: _fit_view(fit) for glove, fit in parts.records.fits_of(name).items()},
        "commands": {str(command): gesture for command, gesture in sorted(commands.gestures.items())},
        "ownCommands": {str(command): gesture for command, gesture in person.commands.items()},
        "ownGestures": {gesture: own_gesture_view(own) for gesture, own in person.gestures.items()},
        "faults": parts.people.faults_of(name),
    }


def own_gesture_view(own: OwnGesture) -> OwnGestureView:
    """Return an own gesture as in answers."""
    return cast("OwnGestureView", own.as_dict())


def _fit_view(fit: Fit) -> FitView:
    thresholds = cast("Any", fit.thresholds.as_dict()) if fit.thresholds else None
    return {"thresholds": thresholds, "recognizer": fit.recognizer, "changedAt": fit.changed_at or None}
