"""A cell with the web UI server, and a WebSocket client that keeps what a browser would keep."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import httpx
import orjson
import pytest
from websockets.sync.client import ClientConnection, connect

from tests.kit.waiting import Bound

Condition = Callable[[], object]


class Viewer:
    """A client of the live WebSocket: it reads while it waits for a condition."""

    def __init__(self, link: ClientConnection) -> None:
        self.topics: dict[str, Any] = {}
        self.events: list[dict[str, Any]] = []
        self.kinds: list[str] = []
        self._link = link

    def read(self, timeout_s: float = 120.0) -> dict[str, Any]:
        """Read the next message."""
        batch: dict[str, Any] = orjson.loads(self._link.recv(timeout=timeout_s))
        self.kinds.append(batch["type"])
        if batch["type"] == "snapshot":
            self.topics.clear()
            self.events.clear()
        for topic, value in batch["topics"].items():
            if value is None:
                self.topics.pop(topic, None)
            else:
                self.topics[topic] = value
        self.events += batch["events"]
        return batch

    def read_until(self, condition: Condition, within_s: float = 40.0) -> None:
        """Read messages until `condition` holds."""
        bound = Bound(within_s)
        while not condition():
            bound.check(self._known)
            with suppress(TimeoutError):
                self.read(5.0)

    def _known(self) -> str:
        return f"topics: {sorted(self.topics)}; events: {[event['text'] for event in self.events[-20:]]}"

    def subscribe(self, *topics: str) -> None:
        """Subscribe to on-demand topics."""
        self._link.send(orjson.dumps({"type": "subscribe", "topics": topics}).decode())

    def event_keys(self, family: str = "") -> list[str]:
        """The keys of the received events, in order."""
        return [event["key"] for event in self.events if event["key"].startswith(family)]

    def service(self, name: str) -> dict[str, Any]:
        """The row of a service."""
        rows: list[dict[str, Any]] = self.topics.get("services", [])
        return next((row for row in rows if row["name"] == name), {"state": None, "since": ""})

    def process(self) -> dict[str, Any]:
        """The only process."""
        found: list[dict[str, Any]] = [
            value for topic, value in self.topics.items() if topic.startswith("process/")
        ]
        return found[0] if found else {}


@pytest.fixture
def look(cell: Any) -> Iterator[Callable[[], Viewer]]:
    """Open a page."""
    with ExitStack() as stack:

        def open_page() -> Viewer:
            url = cell.url("webui")
            live = f"ws{url.removeprefix('http')}/api/live"
            viewer = Viewer(stack.enter_context(connect(live, origin=url, proxy=None, max_size=None)))
            viewer.read()
            return viewer

        yield open_page


@pytest.fixture
def browser(cell: Any) -> Iterator[httpx.Client]:
    """An HTTP client with the headers of a browser."""
    url = cell.url("webui")
    with httpx.Client(base_url=url, headers={"Origin": url}, timeout=120, trust_env=False) as client:
        yield client


@pytest.fixture
def whole_cell(cell: Any) -> Any:
    """A cell with all services, started one after the other."""
    for service in ("context_broker", "task_orchestrator", "gesture_controller", "trajectory_tool", "webui"):
        cell.run(service)
    return cell
