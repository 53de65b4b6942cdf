"""Service health: the state of each service, its rates, and the last message received from it."""

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import httpx
import orjson

from handover.broker import BrokerError
from handover.service_addresses import (
    BROKER,
    DEVICE_GATEWAY,
    GESTURE_CONTROLLER,
    ORCHESTRATOR,
    ROS_BRIDGE,
    TRAJECTORY,
)
from handover_web.live.event_log import Event, EventLog, timestamp
from handover_web.live.live_state import LiveState
from handover_web.live.views import LastMessage, ServiceHealth
from handover_web.sources.broker_abilities import BrokerAbilities
from handover_web.sources.extra_services import ExtraService
from handover_web.sources.source import Source

POLL_INTERVAL_S = 2.0
REQUEST_TIMEOUT_S = 4.0
"""It is longer than `handover.serving.service.CHECK_TIMEOUT_S`: a service says which dependency hangs."""
RATE_WINDOW_S = 6.0

State = Literal["up", "degraded", "down"]

COUNTERS: Final[Mapping[str, Mapping[str, str]]] = {
    BROKER: {
        "requests": "handover_broker_requests_total",
        "notifications": 'handover_broker_notifications_total{outcome="delivered"}',
    },
    ORCHESTRATOR: {
        "steps": "handover_orchestrator_step_duration_seconds_count",
        "news": "handover_orchestrator_task_changes_total",
    },
    GESTURE_CONTROLLER: {
        "frames": "handover_gesture_controller_frames_received_total",
        "tasks": "handover_tasks_total",
    },
    TRAJECTORY: {
        "tasks": "handover_tasks_total",
        "scans": "handover_trajectory_tool_scans_total",
    },
    DEVICE_GATEWAY: {
        "received": "handover_device_messages_total",
        "tasks": "handover_tasks_total",
    },
    ROS_BRIDGE: {
        "received": "handover_bridge_messages_received_total",
        "forwarded": "handover_bridge_messages_forwarded_total",
    },
}
"""The counters of each service, by the key under which the page shows their rate."""
EXTRA_COUNTERS: Final[Mapping[str, str]] = {"tasks": "handover_tasks_total"}
"""The counters of services of other packages, where they have them."""


@dataclass
class ServiceRow:
    """The state of one service; it is shown once its state is known.

    A row without `url` has a permanent state. A row that is not wanted is shown only while it responds.
    """

    name: str
    url: str | None = None
    is_wanted: bool = True
    state: State | None = None
    detail: str | None = None
    since: str = ""
    samples: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    last_message: LastMessage | None = None

    def rates(self) -> dict[str, float]:
        """Return the rates per second over the last few samples."""
        if len(self.samples) < 2:
            return {}
        (began_s, first), (ended_s, last) = self.samples[0], self.samples[-1]
        return {
            key: round(max(last[key] - first.get(key, last[key]), 0.0) / (ended_s - began_s), 2)
            for key in last
        }

    def add_sample(self, at_s: float, counts: Mapping[str, float]) -> None:
        """Add the current values of the counters; lower values mean that the service restarted."""
        if self.samples and any(counts[key] < self.samples[-1][1].get(key, 0.0) for key in counts):
            self.samples.clear()
        if self.samples and at_s - self.samples[-1][0] < POLL_INTERVAL_S / 2:
            return  # an extra check: a rate over so short a time would be noise
        self.samples.append((at_s, counts))
        while len(self.samples) > 2 and at_s - self.samples[1][0] >= RATE_WINDOW_S:
            self.samples.pop(0)

    def view(self) -> ServiceHealth:
        """Return the row as sent to pages."""
        return {
            "name": self.name,
            "url": self.url,
            "state": self.state or "down",
            "detail": self.detail,
            "since": self.since,
            "rates": self.rates(),
            "lastMessage": self.last_message,
        }


class ServiceMonitor(Source):
    """Polls the readiness and the metrics of every service: ours at `urls`, and those of other packages."""

    def __init__(
        self,
        urls: Mapping[str, str],
        http: httpx.AsyncClient,
        abilities: BrokerAbilities,
        state: LiveState,
        events: EventLog,
        *,
        extra: Iterable[ExtraService] = (),
    ) -> None:
        self._http = http
        self._abilities = abilities
        self._state = state
        self._events = events
        self._rows = {name: ServiceRow(name, url) for name, url in urls.items()}
        self._extra = {service.name: service for service in extra if service.name not in urls}
        for name, service in self._extra.items():
            self._rows[name] = ServiceRow(name, service.url, service.is_wanted)
        self._check_requested = asyncio.Event()

    async def run(self) -> None:
        """Check all services every `POLL_INTERVAL_S`."""
        while True:
            self._check_requested.clear()
            await asyncio.gather(*(self._check(row) for row in self._rows.values()))
            self._publish()
            try:
                async with asyncio.timeout(POLL_INTERVAL_S):
                    await self._check_requested.wait()
            except TimeoutError:
                continue

    def record_message(self, name: str, text: str, at: str | None = None) -> None:
        """Set the last message received from a service, or from a performer within one.


        The names of performers begin with the name of their service: `trajectory-tool-ur10-1`.
        """
        for row in self._rows.values():
            if name == row.name or name.startswith(f"{row.name}-"):
                row.last_message = {"at": at or timestamp(), "text": text}

    def check_now(self) -> None:
        """Check all services now: a source found that one stopped or resumed responding."""
        self._check_requested.set()

    def _publish(self) -> None:
        views = [row.view() for row in self._rows.values() if row.state is not None]
        states = [{**view, "url": None, "detail": None, "lastMessage": None} for view in views]
        self._state.publish("services", views, partial=states)

    async def _check(self, row: ServiceRow) -> None:
        url = row.url
        if url is None:
            self._set_state(row, "down", self._extra[row.name].fault)
            return
        try:
            response = await self._http.get(f"{url}/readyz", timeout=REQUEST_TIMEOUT_S)
            state, detail = _state_of(response)
            if row.name == BROKER and not await self._abilities.is_of_ours():
                state, detail = await self._abilities.check()  # it may have no such route
            counts = await self._read_counts(url, row.name)
        except (httpx.HTTPError, asyncio.IncompleteReadError, BrokerError) as error:
            row.samples.clear()
            if not row.is_wanted:
                row.state = None
                return
            state, detail = "down", f"{url} does not respond: {str(error) or type(error).__name__}"
        else:
            if counts:
                row.add_sample(asyncio.get_running_loop().time(), counts)
        self._set_state(row, state, detail)

    async def _read_counts(self, url: str, name: str) -> dict[str, float]:
        response = await self._http.get(f"{url}/metrics", timeout=REQUEST_TIMEOUT_S)
        if not response.is_success:
            return {}
        if name in self._extra:
            return sum_counters(
                response.text,
                {key: counter for key, counter in EXTRA_COUNTERS.items() if counter in response.text},
            )
        return sum_counters(response.text, COUNTERS.get(name, {}))

    def _set_state(self, row: ServiceRow, state: State, detail: str | None) -> None:
        row.detail = detail
        if state == row.state:
            return
        at = timestamp()
        is_up_at_start = row.state is None and state == "up"
        row.state, row.since = state, at
        if is_up_at_start and not (self._events.last_mark(f"service {row.name}") or "up").startswith(("d",)):
            return  # no change: it was up before the restart
        words = {"up": "is ready", "degraded": "is not ready", "down": "does not respond"}[state]
        self._events.record(
            Event(
                subject=f"service {row.name}",
                mark=f"{state}@{at}",
                key=f"service.{state}",
                source=row.name,
                text=f"{row.name} {words}" + (f": {detail}" if detail else ""),
                at=at,
                level={"up": "info", "degraded": "attention", "down": "stop"}[state],  # type: ignore[arg-type]
                values={"service": row.name, "detail": detail or ""},
            )
        )


def sum_counters(metrics: str, counters: Mapping[str, str]) -> dict[str, float]:
    """Return the values of `counters` in a Prometheus text, by their keys.

    A counter is one series with its labels, or a name whose series are summed.
    """
    keys = {name: key for key, name in counters.items()}
    counts = dict.fromkeys(counters, 0.0)
    for line in metrics.splitlines():
        name = line.split("{", 1)[0].split(" ", 1)[0]
        key = keys.get(line.rsplit(" ", 1)[0]) or keys.get(name)
        if key is not None:
            try:
                counts[key] += float(line.rsplit(" ", 1)[1])
            except (ValueError, IndexError):
                continue
    return counts


def _state_of(response: httpx.Response) -> tuple[State, str | None]:
    if response.is_success:
        return "up", None
    try:
        body = orjson.loads(response.content)
    except orjson.JSONDecodeError:
        body = None
    if not isinstance(body, dict):
        return "degraded", f"it responded with {response.status_code}"
    failures = [f"{name}: {why}" for name, why in body.items() if name != "status"]
    return "degraded", "; ".join(failures) or f"it responded with {response.status_code}"
