"""Processes: what the orchestrator says of definitions and of processes, re-read whenever one moves.

An entity that changes is a hint to look; it may reach us before the orchestrator has taken it in, so that
each hint is followed by a second look. Everything is looked at every few seconds anyway.
"""

import asyncio
import random
from collections.abc import Collection, Mapping
from typing import Any, Final
from urllib.parse import quote

import httpx

from datamodels.entities import TaskStatus
from handover.messages import message_in, with_code
from handover.task_life import FINISHED
from handover.telemetry import get_logger
from webui.events import EventLog, Happening, Level, in_milliseconds
from webui.settings import ORCHESTRATOR, WebuiSettings
from webui.sources.devices import short
from webui.sources.entities import Kind
from webui.sources.services import Services
from webui.sources.source import Source
from webui.world import World

log = get_logger(__name__)

KEPT_ENDED: Final = 10
LOOK_AGAIN_S: Final = (0.15, 0.6)
LEAST_PAUSE_S: Final = 0.05
MAX_CONCURRENT_READS: Final = 8
REFRESHED_AT_ONCE: Final = 10
"""Running processes that are read in each round although nothing says that they have changed."""
AWAY_RETRY_S: Final = 0.5
PATIENCE_S: Final = 10.0

LEVELS: Final[Mapping[str, Level]] = {"failed": "stop", "paused": "attention"}

ProcessView = dict[str, Any]


class Processes(Source):
    """Keeps the world informed of definitions, of processes that go on, and of the last that have ended."""

    def __init__(
        self,
        settings: WebuiSettings,
        http: httpx.AsyncClient,
        world: World,
        events: EventLog,
        services: Services,
    ) -> None:
        self._http = http
        self._settings = settings
        self._url = settings.service_urls[ORCHESTRATOR]
        self._world = world
        self._events = events
        self._services = services
        self._running: set[str] = set()
        self._listed: dict[str, Mapping[str, Any]] = {}
        self._to_refresh: list[str] = []
        self._ended: dict[str, str] = {}
        self._told: dict[str, tuple[str, str]] = {}
        self._hinted: set[str] = set()
        self._list_again = True
        self._hint = asyncio.Event()

    def look_at(self, urn: str) -> None:
        """Take the hint that a Process or a Task (by its URN) has moved."""
        name = short(urn)
        if ":Process:" in urn:
            hinted = {name}
            self._list_again |= name not in self._running
        else:
            hinted = {process for process in self._running if name.startswith(f"{process}-")}
        if hinted:
            self._hint_at(hinted)
            loop = asyncio.get_running_loop()
            for delay_s in LOOK_AGAIN_S:
                loop.call_later(delay_s, self._hint_at, hinted)

    async def follow(self) -> None:
        """Look at once at what moves, and at everything every `reconcile_s`."""
        due_s = 0.0
        clock = asyncio.get_running_loop().time
        while True:
            self._hint.clear()
            try:
                if self._list_again or clock() >= due_s:
                    self._list_again = False
                    await self._read_all()
                    due_s = clock() + self._settings.reconcile_s * random.uniform(0.8, 1.2)  # noqa: S311
                hinted, self._hinted = self._hinted, set()
                await self._read_many(hinted)
                wait_s = max(due_s - clock(), 0.0)
            except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
                log.debug("cannot ask the orchestrator", error=str(error))
                self._services.look_now()
                self._list_again, wait_s = True, AWAY_RETRY_S
                self._hint.clear()
            await asyncio.sleep(LEAST_PAUSE_S)
            try:
                async with asyncio.timeout(wait_s):
                    await self._hint.wait()
            except TimeoutError:
                continue

    def _hint_at(self, processes: set[str]) -> None:
        self._hinted |= processes
        self._hint.set()

    async def _read_all(self) -> None:
        await self._read_definitions()
        listed: dict[str, Mapping[str, Any]] = {}
        for status in TaskStatus:
            if status not in FINISHED:
                listed |= {row["id"]: row for row in await self._rows(status, 1000)}
        running = set(listed)
        ended: dict[str, str] = {}
        for status in sorted(FINISHED):
            rows = await self._rows(status, KEPT_ENDED)
            ended |= {row["id"]: str(row.get("endedAt") or row["startedAt"]) for row in rows}
        kept = dict(sorted(ended.items(), key=lambda item: item[1])[-KEPT_ENDED:])
        just_ended = self._running - running
        changed = {process for process, row in listed.items() if self._listed.get(process) != row}
        if not self._to_refresh:
            self._to_refresh = sorted(running)
        refreshed = {self._to_refresh.pop() for _ in self._to_refresh[:REFRESHED_AT_ONCE]} & running
        await self._read_many(changed | refreshed | just_ended | (kept.keys() - self._ended.keys()))
        self._running, self._listed = running, listed
        self._ended = kept
        shown = {f"process/{process}" for process in running | kept.keys()}
        for topic in self._world.names("process"):
            if topic not in shown:
                self._world.forget(topic)
                self._told.pop(topic.partition("/")[2], None)

    async def _read_definitions(self) -> None:
        answer = (await self._ask("/definitions")).raise_for_status()
        definitions = {f"definition/{one['name']}": one for one in answer.json()}
        for topic, definition in definitions.items():
            self._world.tell(topic, {"parameters": [], **definition})
        for topic in self._world.names("definition"):
            if topic not in definitions:
                self._world.forget(topic)

    async def _read_many(self, processes: Collection[str]) -> None:
        slots = asyncio.Semaphore(MAX_CONCURRENT_READS)

        async def read(process: str) -> None:
            async with slots:
                await self._read(process)

        ends = await asyncio.gather(*(read(process) for process in processes), return_exceptions=True)
        for end in ends:
            if isinstance(end, BaseException):
                raise end

    async def _read(self, process: str) -> None:
        answer = await self._ask(f"/processes/{quote(process, safe='')}")
        if answer.status_code == httpx.codes.NOT_FOUND:
            self._world.forget(f"process/{process}")
            self._told.pop(process, None)
            return
        view: ProcessView = answer.raise_for_status().json()
        self._world.tell(f"process/{process}", view)
        if view["status"] in FINISHED:
            self._running.discard(process)
            self._ended.setdefault(process, str(view.get("endedAt")))
        else:
            self._running.add(process)
        self._log(view)

    async def _rows(self, status: str, limit: int) -> list[dict[str, Any]]:
        answer = await self._ask("/processes", status=str(status), limit=limit)
        rows: list[dict[str, Any]] = answer.raise_for_status().json()
        return rows

    async def _ask(self, path: str, **params: str | int) -> httpx.Response:
        return await self._http.get(f"{self._url}{path}", params=params or None, timeout=PATIENCE_S)

    def _log(self, view: ProcessView) -> None:
        status, ended = str(view["status"]), view.get("endedAt")
        if self._told.get(view["id"]) == (status, str(ended)):
            return
        self._told[view["id"]] = (status, str(ended))
        title = _title(view)
        self._record(view, "started", in_milliseconds(view["startedAt"]), f"{title} begins")
        if status in FINISHED:
            reason = message_in(view, "reason") or ""
            words = "is completed" if status == "completed" else f"fails: {reason or 'no reason given'}"
            self._record(view, status, in_milliseconds(ended), f"{title} {words}", reason=reason)

    def _record(self, view: ProcessView, act: str, at: str, text: str, *, reason: str = "") -> None:
        title = _title(view)
        if self._events.record(
            Happening(
                subject=str(view["entity"]),
                mark=f"{act}@{at}",
                key=f"process.{act}",
                source=title,
                text=text,
                at=at,
                level=LEVELS.get(act, "info"),
                values={
                    "process": view["id"],
                    "definition": view["definition"],
                    "title": title,
                    **with_code("reason", reason),
                },
            )
        ):
            self._services.heard(ORCHESTRATOR, text, at)


class ProcessEntities(Kind):
    """Process entities: hints that a process has moved."""

    ngsi_type = "Process"
    open_q = 'status=="pending","assigned","inProgress","paused"'

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self._seen: dict[str, Any] = {}

    def take(self, entity: Mapping[str, Any]) -> None:
        """Have the process looked at, if its entity is another than before."""
        entity_id = str(entity["id"])
        status = entity.get("status")
        value = status.get("value") if isinstance(status, Mapping) else None
        now = (value, repr(entity.get("isComposedOf")))
        if self._seen.get(entity_id) != now:
            self._processes.look_at(entity_id)
        if value in FINISHED:
            self._seen.pop(entity_id, None)
        else:
            self._seen[entity_id] = now

    def still_open(self) -> list[str]:
        """Return the processes that go on."""
        return list(self._seen)

    def gone(self, entity_id: str) -> None:
        """Have a process looked at whose entity was deleted."""
        self._seen.pop(entity_id, None)
        self._processes.look_at(entity_id)


def _title(view: ProcessView) -> str:
    return str(view.get("title") or view["definition"])
