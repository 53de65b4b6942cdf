"""Processes: the definitions and processes of the orchestrator, read again when one changes.

A changed entity is a hint to read the process. It may arrive before the orchestrator has stored the change,
so the process is read once more after each hint. All processes are read periodically as well.
"""

import asyncio
from collections.abc import Collection, Mapping
from typing import Any, Final
from urllib.parse import quote

import httpx

from handover.messages import message_in, with_code
from handover.runtime.retry import Backoff, with_jitter
from handover.service_addresses import ORCHESTRATOR
from handover.tasks.task_life import FINISHED
from handover.telemetry import get_logger
from handover_datamodels.entities import TaskStatus
from handover_web.live.event_log import Event, EventLog, Level, normalized_timestamp
from handover_web.live.live_state import LiveState
from handover_web.settings import WebuiSettings
from handover_web.sources.broker_entities import EntityHandler
from handover_web.sources.devices import short_name
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.source import Source

log = get_logger(__name__)

MAX_ENDED: Final = 10
REREAD_DELAYS_S: Final = (0.15, 0.6)
MIN_INTERVAL_S: Final = 0.05
MAX_CONCURRENT_READS: Final = 8
REFRESH_BATCH_SIZE: Final = 10
"""Running processes that each round reads without a hint."""
INITIAL_RETRY_S, MAX_RETRY_S = 0.5, 2.0
REQUEST_TIMEOUT_S: Final = 10.0

LEVELS: Final[Mapping[str, Level]] = {"failed": "stop", "incident": "stop", "paused": "attention"}

ProcessView = dict[str, Any]


class Processes(Source):
    """Publishes definitions, running processes, and the processes that ended last."""

    def __init__(
        self,
        settings: WebuiSettings,
        http: httpx.AsyncClient,
        state: LiveState,
        events: EventLog,
        services: ServiceMonitor,
    ) -> None:
        self._http = http
        self._settings = settings
        self._url = settings.service_urls[ORCHESTRATOR]
        self._state = state
        self._events = events
        self._services = services
        self._running: set[str] = set()
        self._listed: dict[str, Mapping[str, Any]] = {}
        self._to_refresh: list[str] = []
        self._ended: dict[str, str] = {}
        self._logged: dict[str, tuple[str, str]] = {}
        self._hinted: set[str] = set()
        self._is_list_stale = True
        self._hint = asyncio.Event()

    def refresh(self, urn: str) -> None:
        """Read the process of a changed Process or Task (by its URN)."""
        name = short_name(urn)
        if ":Process:" in urn:
            hinted = {name}
            self._is_list_stale |= name not in self._running
        else:
            hinted = {process for process in self._running if name.startswith(f"{process}-")}
        if hinted:
            self._add_hints(hinted)
            loop = asyncio.get_running_loop()
            for delay_s in REREAD_DELAYS_S:
                loop.call_later(delay_s, self._add_hints, hinted)

    def on_write(self, service: str, path: str) -> None:
        """Read the process that a request of a page has changed; its entity may be the same as before."""
        resource, _, rest = path.strip("/").partition("/")
        process, _, _ = rest.partition("/")
        if service == ORCHESTRATOR and resource == "processes" and process:
            self._add_hints({short_name(process)})

    async def run(self) -> None:
        """Read changed processes at once, and all of them every `reconcile_s`."""
        due_s = 0.0
        clock = asyncio.get_running_loop().time
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            self._hint.clear()
            try:
                if self._is_list_stale or clock() >= due_s:
                    self._is_list_stale = False
                    await self._read_all()
                    due_s = clock() + with_jitter(self._settings.reconcile_s)
                hinted, self._hinted = self._hinted, set()
                await self._read_many(hinted)
                wait_s = max(due_s - clock(), 0.0)
                backoff.reset()
            except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
                log.debug("orchestrator request failed", error=str(error))
                self._services.check_now()
                self._is_list_stale, wait_s = True, backoff.next_delay_s()
                self._hint.clear()
            await asyncio.sleep(MIN_INTERVAL_S)
            try:
                async with asyncio.timeout(wait_s):
                    await self._hint.wait()
            except TimeoutError:
                continue

    def _add_hints(self, processes: set[str]) -> None:
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
            rows = await self._rows(status, MAX_ENDED)
            ended |= {row["id"]: str(row.get("endedAt") or row["startedAt"]) for row in rows}
        kept = dict(sorted(ended.items(), key=lambda item: item[1])[-MAX_ENDED:])
        just_ended = self._running - running
        changed = {process for process, row in listed.items() if self._listed.get(process) != row}
        if not self._to_refresh:
            self._to_refresh = sorted(running)
        refreshed = {self._to_refresh.pop() for _ in self._to_refresh[:REFRESH_BATCH_SIZE]} & running
        await self._read_many(changed | refreshed | just_ended | (kept.keys() - self._ended.keys()))
        self._running, self._listed = running, listed
        self._ended = kept
        shown = {f"process/{process}" for process in running | kept.keys()}
        for topic in self._state.topics_of("process"):
            if topic not in shown:
                self._state.remove(topic)
                self._logged.pop(topic.partition("/")[2], None)

    async def _read_definitions(self) -> None:
        response = (await self._get("/definitions")).raise_for_status()
        definitions = {f"definition/{deployed['name']}": deployed for deployed in response.json()}
        for topic, definition in definitions.items():
            view = {"parameters": [], "holds": [], "translations": {}, **definition}
            self._state.publish(topic, view, self._definition(definition["name"]))
        for topic in self._state.topics_of("definition"):
            if topic not in definitions:
                self._state.remove(topic)

    def _definition(self, name: str) -> tuple[str, ...]:
        return (self._settings.entity_id("ProcessDefinition", name),)

    async def _read_many(self, processes: Collection[str]) -> None:
        slots = asyncio.Semaphore(MAX_CONCURRENT_READS)

        async def read(process: str) -> None:
            async with slots:
                await self._read(process)

        results = await asyncio.gather(*(read(process) for process in processes), return_exceptions=True)
        for result in results:
            if isinstance(result, BaseException):
                raise result

    async def _read(self, process: str) -> None:
        response = await self._get(f"/processes/{quote(process, safe='')}")
        if response.status_code == httpx.codes.NOT_FOUND:
            self._state.remove(f"process/{process}")
            self._logged.pop(process, None)
            return
        view: ProcessView = response.raise_for_status().json()
        self._state.publish(f"process/{process}", view, self._definition(view["definition"]))
        if view["status"] in FINISHED:
            self._running.discard(process)
            self._ended.setdefault(process, str(view.get("endedAt")))
        else:
            self._running.add(process)
        self._log(view)

    async def _rows(self, status: str, limit: int) -> list[dict[str, Any]]:
        response = await self._get("/processes", status=str(status), limit=limit)
        rows: list[dict[str, Any]] = response.raise_for_status().json()
        return rows

    async def _get(self, path: str, **params: str | int) -> httpx.Response:
        return await self._http.get(f"{self._url}{path}", params=params or None, timeout=REQUEST_TIMEOUT_S)

    def _log(self, view: ProcessView) -> None:
        status, ended = str(view["status"]), view.get("endedAt")
        title = str(view["name"])
        self._log_incidents(view, title)
        if self._logged.get(view["id"]) == (status, str(ended)):
            return
        self._logged[view["id"]] = (status, str(ended))
        self._record(view, "started", normalized_timestamp(view["startedAt"]), f"{title} started")
        if status in FINISHED:
            reason = message_in(view, "reason") or ""
            words = "completed" if status == "completed" else f"failed: {reason or 'no reason given'}"
            self._record(view, status, normalized_timestamp(ended), f"{title} {words}", reason=reason)

    def _log_incidents(self, view: ProcessView, title: str) -> None:
        for incident in view.get("incidents", ()):
            name = str(incident["name"] or incident["element"])
            reason = message_in(incident, "reason") or ""
            self._record(
                view,
                "incident",
                normalized_timestamp(incident["since"]),
                f'{title}: incident at "{name}": {reason}',
                reason=reason,
                token=str(incident["token"]),
                more={"name": name},
            )

    def _record(
        self,
        view: ProcessView,
        act: str,
        at: str,
        text: str,
        *,
        reason: str = "",
        token: str = "",
        more: Mapping[str, Any] | None = None,
    ) -> None:
        if self._events.record(
            Event(
                subject=str(view["entity"]),
                mark=f"{act}@{at}" + (f"@{token}" if token else ""),
                key=f"process.{act}",
                source=_title(view),
                text=text,
                at=at,
                level=LEVELS.get(act, "info"),
                values={
                    "process": view["id"],
                    "definition": view["definition"],
                    "title": str(view["name"]),
                    **(more or {}),
                    **with_code("reason", reason),
                },
            )
        ):
            self._services.record_message(ORCHESTRATOR, text, at)


class ProcessEntities(EntityHandler):
    """Process entities: each change is a hint to read the process."""

    ngsi_type = "Process"
    active_q = 'status=="pending","assigned","inProgress","paused"'

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self._seen: dict[str, Any] = {}

    def update(self, entity: Mapping[str, Any]) -> None:
        """Have the process read if its entity changed."""
        entity_id = str(entity["id"])
        status = entity.get("status")
        value = status.get("value") if isinstance(status, Mapping) else None
        now = (value, repr(entity.get("isComposedOf")))
        if self._seen.get(entity_id) != now:
            self._processes.refresh(entity_id)
        if value in FINISHED:
            self._seen.pop(entity_id, None)
        else:
            self._seen[entity_id] = now

    def active_ids(self) -> list[str]:
        """Return the running processes."""
        return list(self._seen)

    def remove(self, entity_id: str) -> None:
        """Have the process of a deleted entity read."""
        self._seen.pop(entity_id, None)
        self._processes.refresh(entity_id)


def _title(view: ProcessView) -> str:
    return str(view.get("title") or view["definition"])
