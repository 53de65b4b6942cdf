"""A lasting strain proposes a break to the process: a BPMN message to the orchestrator.

A process waits for the message with an event (`breakProposed`) whose key is the pseudonym of the person, or
starts by it. The variables are the pseudonym and the mean exertion; a process knows the person only if it
knows the pseudonym.
"""

import orjson

from handover.errors import HandoverError
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.people.consent import Purpose
from handover_body.settings import HumanStateSettings

log = get_logger(__name__)

TIMEOUT_S = 5.0
TTL = "PT5M"


class BreakProposals:
    """Sends the message, once for each lasting strain."""

    def __init__(self, settings: HumanStateSettings, access: ServiceAccess) -> None:
        self._settings = settings
        self._access = access
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files, max_response_bytes=64 * 1024)

    async def propose(self, monitor: PersonMonitor) -> None:
        """Propose a break for a person who consents to limits."""
        name = self._settings.health_break_message
        if not name or Purpose.SPEED_LIMITS not in monitor.person.purposes():
            return
        pseudonym = monitor.person.pseudonym
        body = {
            "name": name,
            "key": pseudonym,
            "ttl": TTL,
            "variables": {"pseudonym": pseudonym, "strain": round(monitor.strain.mean, 2)},
        }
        url = f"{self._settings.orchestrator}/messages"
        try:
            headers = [("Content-Type", "application/json")]
            answer = await self._access.send(
                self._http, "POST", url, headers, orjson.dumps(body), timeout_s=TIMEOUT_S
            )
        except (SendError, OSError, HandoverError) as error:
            log.warning("break not proposed", error=str(error))
            return
        if answer.status >= 300:
            log.warning("break not proposed", status=answer.status)

    def close(self) -> None:
        """Close the connections."""
        self._http.close()
