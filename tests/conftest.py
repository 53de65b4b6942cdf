"""A cell for a test: the real services as processes, on free ports, in a directory of their own."""

import functools
import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import hypothesis
import pytest
from httpx._transports import default as transports

from handover.settings import Settings
from tests import lifeline

REPOSITORY = Path(__file__).parent.parent
RECORDINGS = REPOSITORY.parent / "shared" / "data" / "glove_recordings"

OUTSIDE = frozenset({"webui", "ros_fiware_bridge"})
"""Services whose folder is not in `services`."""

NOT_OURS = "are not here"
"""Part of the reason for which tests of published examples and recordings skip where those are absent."""

NO_ROS = "rclpy is not installed; make ros-test runs these tests"
"""The reason for which tests against genuine ROS 2 nodes skip, but not where `make ros-test` runs them."""

ROS_TYPES = "an installed ROS knows only types that were built for it"
"""The reason for which tests with types of their own skip on rclpy."""

NO_IPV6 = "this machine has no IPv6"
"""The reason for which tests of IPv6 skip: containers often have none."""

EXAMPLES = int(os.environ.get("HANDOVER_TEST_EXAMPLES", "25"))
"""How many examples are tried of what must hold of any; more than the usual are drawn by luck, and look
further, but in CI: what it says of a change must not depend on luck."""

hypothesis.settings.register_profile(
    "ours",
    max_examples=EXAMPLES,
    derandomize=EXAMPLES <= 25 or bool(os.environ.get("CI")),
    # How long an example takes is no concern of a test: machines are slow at times.
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("ours")

# Every client would read the authorities of the whole world first: 15 ms, and tests ask a thousand times.
transports.create_ssl_context = functools.cache(httpx.create_ssl_context)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job: deaf, and so its children
    signal.signal(signal.SIGINT, signal.default_int_handler)

_worker = int(re.sub(r"\D", "", os.environ.get("PYTEST_XDIST_WORKER", "")) or 0)
_candidates = itertools.count(15_000 + 2_000 * (_worker % 8) + os.getpid() * 37 % 1_200)


_tenants = itertools.count(1)


def next_free_port() -> int:
    """Return a port nobody listens on, below those the system hands out, another for each call and worker."""
    for port in _candidates:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("no free port")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Share the tests out by what they have in common, if there are several workers."""
    from tests.shares import Shares

    return Shares(config, log)


STARTS_SERVICES = frozenset({"cell", "shared_cell", "host_cell", "own_broker"})
"""The fixtures with which a test starts services for itself or for its module."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Who starts services is slow, if nobody has said so: an everyday change does not wait for that."""
    for item in items:
        if isinstance(item, pytest.Function) and not STARTS_SERVICES.isdisjoint(item.fixturenames):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """In CI only tests of recordings that are not ours, of IPv6, and of rclpy outside `ros-test` may skip."""
    report = yield
    with_ros = bool(os.environ.get("HANDOVER_TEST_ROS"))
    reasons = (NOT_OURS, NO_IPV6, ROS_TYPES if with_ros else NO_ROS)
    allowed = any(reason in str(report.longrepr) for reason in reasons)
    if report.skipped and (os.environ.get("CI") or with_ros) and not allowed:
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} was skipped, which CI does not allow: {report.longrepr}"
    return report


@pytest.fixture
def free_port() -> Callable[[], int]:
    """Give free ports, one a call."""
    return next_free_port


@pytest.fixture(scope="session")
def new_database() -> Iterator[Callable[[], str]]:
    """Make databases on one PostgreSQL server; each call returns the URL of a new one."""
    from tests.postgres import postgres_server

    with postgres_server() as server:
        yield server.new_database


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real glove recordings; skips where it is absent."""
    if not RECORDINGS.is_dir():
        pytest.skip(f"the glove recordings are not here ({RECORDINGS})")
    return RECORDINGS


@dataclass
class Cell:
    """The services of one cell; `start` and `kill` them by the name of their folder."""

    data_dir: Path
    ports: dict[str, int]
    extra: dict[str, str] = field(default_factory=dict)
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    host: "Cell | None" = None
    """Whose broker this cell uses, as a tenant of its own."""
    tenant: str = ""

    @property
    def settings(self) -> Settings:
        """What a client of this cell's broker is told."""
        return Settings.load(broker_url=self.url("context_broker"), broker_tenant=self.tenant or None)

    @property
    def environment(self) -> dict[str, str]:
        """What the processes of this cell are told."""
        return {
            **{name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")},
            "HANDOVER_DATA_DIR": str(self.data_dir),
            "HANDOVER_BROKER_URL": self.url("context_broker"),
            "HANDOVER_BROKER_PORT": str(self.ports["context_broker"]),
            "HANDOVER_ORCHESTRATOR_PORT": str(self.ports["task_orchestrator"]),
            "HANDOVER_CONTROLLER_PORT": str(self.ports["gesture_controller"]),
            "HANDOVER_TRAJECTORY_PORT": str(self.ports["trajectory_tool"]),
            "HANDOVER_GLOVE_PORT": str(self.ports["glove"]),
            "HANDOVER_WEBUI_PORT": str(self.ports["webui"]),
            "HANDOVER_BRIDGE_PORT": str(self.ports["ros_fiware_bridge"]),
            "HANDOVER_RECONCILE_S": "1",
            **({"HANDOVER_BROKER_TENANT": self.tenant} if self.tenant else {}),
            "COLUMNS": "200",
            "NO_COLOR": "1",
            **self.extra,
        }

    def url(self, service: str) -> str:
        """Where a service answers."""
        return f"http://127.0.0.1:{self.ports[service]}"

    def log(self, service: str) -> str:
        """What a service has logged."""
        return (self.data_dir / f"{service}.log").read_text(errors="replace")

    def start(self, *services: str, within_s: float = 30.0) -> None:
        """Start services and wait until each is ready."""
        if self.host and "context_broker" in services:
            self.host.start("context_broker")
            services = tuple(service for service in services if service != "context_broker")
        for service in services:
            with (self.data_dir / f"{service}.log").open("ab") as log:
                self.processes[service] = subprocess.Popen(
                    [sys.executable, "-m", service if service in OUTSIDE else f"services.{service}"],
                    env=self.environment | lifeline.TOLD,
                    cwd=self.data_dir,
                    stdin=lifeline.STDIN,
                    stdout=log,
                    stderr=log,
                )
        for service in services:
            self.wait_ready(service, within_s)

    def run(self, *services: str) -> None:
        """Start those of the services that do not run."""
        self.start(*(service for service in services if not self.runs(service)))

    def runs(self, service: str) -> bool:
        """Whether a service has been started and has not ended."""
        if self.host and service == "context_broker":
            return self.host.runs(service)
        process = self.processes.get(service)
        return process is not None and process.poll() is None

    def wait_ready(self, service: str, within_s: float = 30.0) -> None:
        """Wait until a service says that it is ready."""

        def ready() -> bool:
            process = self.processes.get(service)
            assert process is None or process.poll() is None, f"{service} ended: {self.log(service)[-2000:]}"
            try:
                return httpx.get(f"{self.url(service)}/readyz", timeout=5).is_success
            except httpx.TransportError:
                return False

        wait_until(ready, within_s, lambda: f"{service} is not ready: {self.log(service)[-2000:]}")

    def kill(self, service: str) -> None:
        """End a service as a power cut would."""
        if self.host and service == "context_broker":
            self.host.kill(service)
            return
        process = self.processes.pop(service)
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=10)

    def stop(self) -> None:
        """End every service."""
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(timeout=10)


def wait_until(
    condition: Callable[[], object], within_s: float = 20.0, why: Callable[[], str] = lambda: "it never came"
) -> None:
    """Wait until `condition` holds; fail with `why` when it has not within `within_s`."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, why()
        time.sleep(0.02)


@pytest.fixture
def eventually() -> Callable[..., None]:
    """Wait for a condition with a bound."""
    return wait_until


@contextmanager
def new_cell(data_dir: Path) -> Iterator[Cell]:
    """A cell of which nothing runs yet; what runs at the end is ended."""
    names = (
        "context_broker",
        "task_orchestrator",
        "gesture_controller",
        "trajectory_tool",
        "glove",
        "webui",
        "ros_fiware_bridge",
    )
    made = Cell(data_dir, {name: next_free_port() for name in names})
    try:
        yield made
    finally:
        made.stop()


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    """A cell of which nothing runs yet, for one test."""
    with new_cell(tmp_path) as made:
        yield made


@pytest.fixture(scope="session")
def host_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell of a broker alone, for cells that are its tenants."""
    with new_cell(tmp_path_factory.mktemp("host")) as made:
        yield made


@pytest.fixture
def tenant_cell(cell: Cell, host_cell: Cell) -> Cell:
    """A cell with a broker in which there is nothing yet: one that others use too, each as another tenant."""
    host_cell.run("context_broker")
    cell.host, cell.tenant = host_cell, f"cell-{next(_tenants)}"
    cell.ports["context_broker"] = host_cell.ports["context_broker"]
    return cell


@pytest.fixture(scope="module")
def shared_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell for all tests of a module, whose names do not meet; each sees to it that what it needs runs."""
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        yield made
