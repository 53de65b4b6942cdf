"""A cell with the screen's server in it, and a page that looks: what a browser keeps, without a browser."""

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
    """A page that is open: it reads whenever it waits for something."""

    def __init__(self, link: ClientConnection) -> None:
        self.topics: dict[str, Any] = {}
        self.events: list[dict[str, Any]] = []
        self.kinds: list[str] = []
        self._link = link

    def read(self, timeout_s: float = 120.0) -> dict[str, Any]:
        """Take in the next batch."""
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
        """Take in batches until `condition` holds."""
        bound = Bound(within_s)
        while not condition():
            bound.check(lambda: f"not seen; known: {sorted(self.topics)}; events: {self.happened()[-20:]}")
            with suppress(TimeoutError):
                self.read(5.0)

    def want(self, *topics: str) -> None:
        """Say what is wanted beyond the usual."""
        self._link.send(orjson.dumps({"type": "want", "topics": topics}).decode())

    def happened(self, family: str = "") -> list[str]:
        """What has happened, in order."""
        return [event["key"] for event in self.events if event["key"].startswith(family)]

    def service(self, name: str) -> dict[str, Any]:
        """The row of a service."""
        rows: list[dict[str, Any]] = self.topics.get("services", [])
        return next((row for row in rows if row["name"] == name), {"state": None, "since": ""})

    def process(self) -> dict[str, Any]:
        """The one process that there is."""
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
    """What a page calls, with the headers that a browser sends."""
    url = cell.url("webui")
    with httpx.Client(base_url=url, headers={"Origin": url}, timeout=120, trust_env=False) as client:
        yield client


@pytest.fixture
def whole_cell(cell: Any) -> Any:
    """A cell in which everything runs; started one after the other, since five at once are slow to come."""
    for service in ("context_broker", "task_orchestrator", "gesture_controller", "trajectory_tool", "webui"):
        cell.run(service)
    return cell
