"""A cell for tests: broker, orchestrator and a scripted performer as real processes that can be killed."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import httpx

from tests.kit import processes
from tests.kit.databases import broker_settings, default_url, service_settings
from tests.kit.other_broker import running
from tests.kit.waiting import wait_for

FreePort = Callable[[], int]
T = TypeVar("T")


def eventually(look: Callable[[], T | None], what: str) -> T:
    """Return the first true value of `look`; fail with `what` if there is none."""
    return wait_for(look, 60, f"{what} did not come about")


class Member:
    """A process of the cell: `start` it, `kill` it without warning, `start` it again.

    `program` is a module, or the file of a script.
    """

    def __init__(
        self, name: str, program: str | Path, environment: Mapping[str, str], log: Path, ready: str
    ) -> None:
        self.name = name
        self._program = program
        self.environment = environment
        self._log = log
        self._ready = ready
        self._process: processes.Process | None = None

    def start(self) -> None:
        """Start it and wait until it answers."""
        self.launch()
        self.wait()

    def launch(self) -> None:
        """Start it without waiting."""
        if isinstance(self._program, Path):
            command = [sys.executable, str(self._program)]
            self._process = processes.spawn(command, self.environment, self._log, self._log.parent)
        else:
            self._process = processes.spawn_module(
                self._program, self.environment, self._log, self._log.parent
            )

    def run(self) -> None:
        """Start it if it does not run."""
        if self._process is None or self._process.poll() is not None:
            self.start()

    def wait(self) -> None:
        """Wait until it answers."""
        processes.wait_ready(self._process, self._ready, self.log, 60)

    def kill(self) -> None:
        """End it as a power cut does."""
        assert self._process is not None
        processes.kill(self._process)

    def stop(self) -> None:
        """End it in good order."""
        if self._process is not None and self._process.poll() is None:
            processes.stop(self._process)

    def log(self) -> str:
        """Return what it has logged."""
        return self._log.read_text(errors="replace")


class BrokerMember(Member):
    """A broker that takes the place of our own."""

    def __init__(self, port: int, environment: Mapping[str, str], folder: Path) -> None:
        url = f"http://127.0.0.1:{port}{running.ready_path('context_broker')}"
        super().__init__("broker", running.MODULE, environment, folder / "broker.log", url)
        self._broker = running.OtherBroker(port, folder)

    def launch(self) -> None:
        self._process = self._broker.spawn(self.environment, self._log)

    def kill(self) -> None:
        super().kill()
        self._broker.kill()

    def stop(self) -> None:
        super().stop()
        self._broker.stop()


class Cell:
    """The broker, the orchestrator and a performer that writes down each time it does something."""

    def __init__(
        self,
        folder: Path,
        free_port: FreePort,
        database_url: str | None = None,
        extra: Mapping[str, str] | None = None,
        standby_urls: Sequence[str] = (),
    ) -> None:
        broker, orchestrator, performer = free_port(), free_port(), free_port()
        self.database = database_url or default_url(folder) or f"sqlite:///{folder / 'orchestrator.db'}"
        """The URL of the orchestrator's database."""
        self.done_file = folder / "done.txt"
        self.script_file = folder / "script.json"
        self.script_file.write_text("{}")
        environment = {
            **processes.clean_environment(),
            "PYTHONUNBUFFERED": "1",
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_BROKER_PORT": str(broker),
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
            "HANDOVER_ORCHESTRATOR_PORT": str(orchestrator),
            "HANDOVER_RECONCILE_S": "0.5",
            **broker_settings(folder),
            **running.settings(),
            **(extra or {}),
        }
        environment = {name: value for name, value in environment.items() if value}  # "" removes a setting
        database = {"HANDOVER_DATABASE_URL": database_url} if database_url else service_settings(folder)
        of_orchestrator = {**environment, **database}
        of_performer = {
            **environment,
            "HANDOVER_LEASE_URLS": ",".join([f"http://127.0.0.1:{orchestrator}", *standby_urls]),
            "PERFORMER_PORT": str(performer),
            "PERFORMER_DONE": str(self.done_file),
            "PERFORMER_SCRIPT": str(self.script_file),
        }
        self.broker = (
            BrokerMember(broker, environment, folder)
            if running.IS_OTHER
            else Member(
                "broker",
                "handover_broker",
                environment,
                folder / "broker.log",
                f"http://127.0.0.1:{broker}/readyz",
            )
        )
        self.orchestrator = Member(
            "orchestrator",
            "handover_processes",
            of_orchestrator,
            folder / "orchestrator.log",
            f"http://127.0.0.1:{orchestrator}/healthz",
        )
        self.performer = Member(
            "performer",
            Path(__file__).parent / "scripted_performer.py",
            of_performer,
            folder / "performer.log",
            f"http://127.0.0.1:{performer}/healthz",
        )
        self.members = (self.broker, self.orchestrator, self.performer)
        self.api = httpx.Client(base_url=f"http://127.0.0.1:{orchestrator}", trust_env=False, timeout=120)
        self.entities = httpx.Client(
            base_url=f"http://127.0.0.1:{broker}/ngsi-ld/v1/entities",
            headers={"Link": running.context_link()},
            trust_env=False,
            timeout=120,
        )

    def start(self, definition: str, **parameters: Any) -> str:
        """Start a process and return its id."""
        answer = self.api.post("/processes", json={"definition": definition, "parameters": parameters})
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    def look(self, process: str) -> dict[str, Any]:
        """Return the process as the orchestrator shows it."""
        answer = self.api.get(f"/processes/{process}")
        assert answer.status_code == 200, answer.text
        seen: dict[str, Any] = answer.json()
        return seen

    def ended(self, process: str) -> dict[str, Any]:
        """Wait until the process has ended and return it."""
        return wait_for(lambda: self._if_ended(process), 60, f"{process} has not ended")

    def _if_ended(self, process: str) -> dict[str, Any] | None:
        seen = self.look(process)
        return seen if seen["endedAt"] else None

    def stuck(self, process: str) -> dict[str, Any]:
        """Wait until the process has an incident and return it."""

        def look() -> dict[str, Any] | None:
            seen = self.look(process)
            return seen if seen["incidents"] else None

        return wait_for(look, 60, f"{process} has no incident")

    def done(self) -> list[str]:
        """Return what the performer has done, in order: `element-visit`."""
        return self.done_file.read_text().split() if self.done_file.exists() else []

    def entity(self, entity_id: str) -> dict[str, Any] | None:
        """Return an entity of the broker, None if it is not there."""
        answer = self.entities.get(f"/{entity_id}")
        if answer.status_code == 404:
            return None
        seen: dict[str, Any] = answer.json()
        return seen

    def of_type(self, kind: str) -> list[dict[str, Any]]:
        """Return the entities of a type."""
        listed: list[dict[str, Any]] = self.entities.get("", params={"type": kind, "limit": 500}).json()
        return listed

    def tasks(self, process: str) -> list[dict[str, Any]]:
        """Return the Task entities of a process."""
        return [task for task in self.of_type("Task") if _is_of(task["id"], process)]

    def alerts(self, process: str) -> list[dict[str, Any]]:
        """Return the Alerts about a process and its Tasks."""
        return [one for one in self.of_type("Alert") if _is_of(one["alertSource"]["object"], process)]


def _is_of(entity_id: str, process: str) -> bool:
    return entity_id.rpartition(":")[2] == process or f":{process}-" in entity_id


@contextmanager
def cell(
    folder: Path,
    free_port: FreePort,
    database_url: str | None = None,
    extra: Mapping[str, str] | None = None,
    standby_urls: Sequence[str] = (),
) -> Iterator[Cell]:
    """Run a cell with all its members up; `extra` are settings of all of them.

    `standby_urls` are the addresses of further orchestrators on its database.
    """
    running = Cell(folder, free_port, database_url, extra, standby_urls)
    try:
        for member in running.members:
            member.start()
        yield running
    finally:
        running.api.close()
        running.entities.close()
        for member in reversed(running.members):
            member.stop()
