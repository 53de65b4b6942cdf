"""Services: whether each answers and can work, how much it does a second, and what was last heard of it."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import httpx
import orjson

from handover.broker import BrokerClient, BrokerError
from webui.events import EventLog, Happening, now
from webui.settings import BROKER, CONTROLLER, ORCHESTRATOR, ROS_BRIDGE, TRAJECTORY
from webui.sources.source import Source
from webui.world import World

LOOK_EVERY_S = 2.0
PATIENCE_S = 1.5
RATE_OVER_S = 6.0

State = Literal["up", "degraded", "down"]

COUNTED: Final[Mapping[str, Mapping[str, str]]] = {
    BROKER: {
        "requests": "handover_broker_requests_total",
        "notifications": 'handover_broker_notifications_total{outcome="delivered"}',
    },
    ORCHESTRATOR: {
        "steps": "handover_orchestrator_step_duration_seconds_count",
        "news": "handover_orchestrator_task_changes_total",
    },
    CONTROLLER: {
        "frames": "handover_gesture_controller_frames_received_total",
        "tasks": "handover_tasks_total",
    },
    TRAJECTORY: {
        "tasks": "handover_tasks_total",
        "scans": "handover_trajectory_tool_scans_total",
    },
    ROS_BRIDGE: {
        "received": "handover_bridge_messages_received_total",
        "forwarded": "handover_bridge_messages_forwarded_total",
    },
}
"""What is counted of a service, by the word that the page has for it, and the counters that count it."""


@dataclass
class Row:
    """What is known of one service."""

    name: str
    state: State | None = None
    detail: str | None = None
    since: str = ""
    counts: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    last_message: dict[str, str] | None = None

    def rates(self) -> dict[str, float]:
        """Return how much is counted a second, over the last few looks."""
        if len(self.counts) < 2:
            return {}
        (began_s, first), (ended_s, last) = self.counts[0], self.counts[-1]
        return {
            word: round(max(last[word] - first.get(word, last[word]), 0.0) / (ended_s - began_s), 2)
            for word in last
        }

    def counted(self, at_s: float, counts: Mapping[str, float]) -> None:
        """Take what the counters say now; a service that was started anew counts from zero again."""
        if self.counts and any(counts[word] < self.counts[-1][1].get(word, 0.0) for word in counts):
            self.counts.clear()
        if self.counts and at_s - self.counts[-1][0] < LOOK_EVERY_S / 2:
            return  # a look out of turn: a rate over so short a time would say nothing
        self.counts.append((at_s, counts))
        while len(self.counts) > 2 and at_s - self.counts[1][0] >= RATE_OVER_S:
            self.counts.pop(0)

    def view(self) -> dict[str, Any]:
        """Return the row as pages get it."""
        return {
            "name": self.name,
            "state": self.state,
            "detail": self.detail,
            "since": self.since,
            "rates": self.rates(),
            "lastMessage": self.last_message,
        }


class Services(Source):
    """Asks every service how it is, again and again."""

    def __init__(
        self,
        urls: Mapping[str, str],
        http: httpx.AsyncClient,
        broker: BrokerClient,
        world: World,
        events: EventLog,
    ) -> None:
        self._urls = urls
        self._http = http
        self._broker = broker
        self._world = world
        self._events = events
        self._rows = {name: Row(name) for name in urls}
        self._look_now = asyncio.Event()

    async def follow(self) -> None:
        """Ask all of them every `LOOK_EVERY_S`."""
        while True:
            self._look_now.clear()
            await asyncio.gather(*(self._look(row) for row in self._rows.values()))
            self._tell()
            try:
                async with asyncio.timeout(LOOK_EVERY_S):
                    await self._look_now.wait()
            except TimeoutError:
                continue

    def heard(self, name: str, text: str, at: str | None = None) -> None:
        """Take `text` for the last that was heard of a service, or of a performer that works in one.

        A service with several performers names each after itself: `trajectory-tool-ur10-1`.
        """
        for row in self._rows.values():
            if name == row.name or name.startswith(f"{row.name}-"):
                row.last_message = {"at": at or now(), "text": text}

    def look_now(self) -> None:
        """Ask without waiting: somebody has met a service that does not answer, or does again."""
        self._look_now.set()

    def _tell(self) -> None:
        self._world.tell("services", [row.view() for row in self._rows.values() if row.state is not None])

    async def _look(self, row: Row) -> None:
        url = self._urls[row.name]
        try:
            answer = await self._http.get(f"{url}/readyz", timeout=PATIENCE_S)
            state, detail = _state_of(answer)
            if answer.status_code == httpx.codes.NOT_FOUND and row.name == BROKER:
                await self._broker.probe()  # a broker of another make has no such page, but answers NGSI-LD
                state, detail = "up", None
            counts = await self._counts(url, row.name)
        except (httpx.HTTPError, asyncio.IncompleteReadError, BrokerError) as error:
            row.counts.clear()
            state, detail = "down", f"{url} does not answer: {str(error) or type(error).__name__}"
        else:
            if counts:
                row.counted(asyncio.get_running_loop().time(), counts)
        self._now_is(row, state, detail)

    async def _counts(self, url: str, name: str) -> dict[str, float]:
        answer = await self._http.get(f"{url}/metrics", timeout=PATIENCE_S)
        if not answer.is_success:
            return {}
        return summed(answer.text, COUNTED.get(name, {}))

    def _now_is(self, row: Row, state: State, detail: str | None) -> None:
        row.detail = detail
        if state == row.state:
            return
        at = now()
        began_well = row.state is None and state == "up"
        row.state, row.since = state, at
        if began_well and not (self._events.last_mark(f"service {row.name}") or "up").startswith(("d",)):
            return  # nothing new: it was up when last seen, and is
        words = {"up": "works", "degraded": "answers but cannot work", "down": "does not answer"}[state]
        self._events.record(
            Happening(
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


def summed(metrics: str, counters: Mapping[str, str]) -> dict[str, float]:
    """Return what `metrics` (the Prometheus text) counts, by the words of `counters`.

    A counter is one series, with its labels, or the sum of all series of a name.
    """
    words = {name: word for word, name in counters.items()}
    counts = dict.fromkeys(counters, 0.0)
    for line in metrics.splitlines():
        name = line.split("{", 1)[0].split(" ", 1)[0]
        word = words.get(line.rsplit(" ", 1)[0]) or words.get(name)
        if word is not None:
            try:
                counts[word] += float(line.rsplit(" ", 1)[1])
            except (ValueError, IndexError):
                continue
    return counts


def _state_of(answer: httpx.Response) -> tuple[State, str | None]:
    if answer.is_success:
        return "up", None
    try:
        said = orjson.loads(answer.content)
    except orjson.JSONDecodeError:
        said = None
    if not isinstance(said, dict):
        return "degraded", f"it answers {answer.status_code}"
    failures = [f"{name}: {why}" for name, why in said.items() if name != "status"]
    return "degraded", "; ".join(failures) or f"it answers {answer.status_code}"
