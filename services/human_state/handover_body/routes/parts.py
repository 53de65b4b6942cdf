"""What the routes of persons and sensors share."""

from dataclasses import dataclass
from typing import Annotated

from handover.errors import Problem
from handover.security.caller import Caller
from handover.security.guard import require_by_handler
from handover.security.permissions import Permission
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.monitoring.removal import Removal
from handover_body.people.people import People
from handover_body.storage.store import Store

Configurer = Annotated[Caller, require_by_handler(Permission.CONFIGURE, "for the person")]


@dataclass(frozen=True, slots=True)
class Parts:
    """What the routes use."""

    people: People
    monitoring: Monitoring
    store: Store
    removal: Removal

    def monitor_of(self, person: str) -> PersonMonitor:
        """Return the monitor of a person; raise `Problem` 404, or 409 without consent."""
        self.people.person(person)
        monitor = self.monitoring.monitors.get(person)
        if monitor is None:
            raise Problem.translated(
                409,
                "No consent",
                "health.no_consent",
                "{person} has given no consent that is valid now, so nothing is processed; ask the person",
                person=person,
            )
        return monitor
