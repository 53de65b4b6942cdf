"""A cell for a test: the real services as processes, on free ports, in a directory of their own."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from handover.settings import Settings
from tests.kit import databases, processes
from tests.kit.other_broker import running
from tests.kit.ports import next_free_port
from tests.kit.processes import Process
from tests.kit.waiting import scaled

MODULES = {
    "context_broker": "handover_broker",
    "task_orchestrator": "handover_processes",
    "gesture_controller": "handover_gloves",
    "trajectory_tool": "handover_robots",
    "human_state": "handover_body",
    "device_gateway": "handover_devices",
    "alert_router": "handover_alerts",
    "accounts": "handover_accounts",
    "assistive_devices": "handover_cases",
    "study": "handover_study",
    "whole_body_control": "handover_humanoid",
    "webui": "handover_web",
    "ros_fiware_bridge": "handover_ros",
}
"""The import package of each service."""

SERVICES = (
    "context_broker",
    "task_orchestrator",
    "gesture_controller",
    "trajectory_tool",
    "study",
    "device_gateway",
    "alert_router",
    "human_state",
    "assistive_devices",
    "whole_body_control",
    "devices",
    "accounts",
    "glove",
    "webui",
    "ros_fiware_bridge",
)
"""What has a port of its own; `glove` is the controller's TCP port for gloves, `devices` the gateway's."""


@dataclass
class Cell:
    """The services of one cell; `start` and `kill` them by the name of their folder."""

    data_dir: Path
    ports: dict[str, int]
    extra: dict[str, str] = field(default_factory=dict)
    """Settings of this cell beside the usual ones."""
    processes: dict[str, Process] = field(default_factory=dict)
    host: "Cell | None" = None
    """The cell whose broker this cell uses, as a tenant of its own."""
    tenant: str = ""
    other_broker: running.OtherBroker | None = None
    """The broker in place of our own, once it has been started."""

    @property
    def settings(self) -> Settings:
        """The settings of a client of this cell's broker."""
        return Settings.load(
            broker_url=self.url("context_broker"),
            broker_tenant=self.tenant or None,
            context_url=running.context_url(),
        )

    @property
    def environment(self) -> dict[str, str]:
        """The environment of this cell's processes."""
        return {
            **processes.clean_environment(),
            "HANDOVER_DATA_DIR": str(self.data_dir),
            "HANDOVER_BROKER_URL": self.url("context_broker"),
            "HANDOVER_BROKER_PORT": str(self.ports["context_broker"]),
            "HANDOVER_ORCHESTRATOR_PORT": str(self.ports["task_orchestrator"]),
            "HANDOVER_CONTROLLER_PORT": str(self.ports["gesture_controller"]),
            "HANDOVER_TRAJECTORY_PORT": str(self.ports["trajectory_tool"]),
            "HANDOVER_STUDY_PORT": str(self.ports["study"]),
            "HANDOVER_GATEWAY_PORT": str(self.ports["device_gateway"]),
            "HANDOVER_ALERT_ROUTER_PORT": str(self.ports["alert_router"]),
            "HANDOVER_HUMAN_STATE_PORT": str(self.ports["human_state"]),
            "HANDOVER_ASSISTIVE_PORT": str(self.ports["assistive_devices"]),
            "HANDOVER_WHOLE_BODY_PORT": str(self.ports["whole_body_control"]),
            "HANDOVER_DEVICE_PORT": str(self.ports["devices"]),
            "HANDOVER_ACCOUNTS_PORT": str(self.ports["accounts"]),
            "HANDOVER_GLOVE_PORT": str(self.ports["glove"]),
            "HANDOVER_WEBUI_PORT": str(self.ports["webui"]),
            "HANDOVER_BRIDGE_PORT": str(self.ports["ros_fiware_bridge"]),
            "HANDOVER_RECONCILE_S": "1",
            **databases.service_settings(self.data_dir),
            **databases.broker_settings(self.data_dir),
            **({"HANDOVER_BROKER_TENANT": self.tenant} if self.tenant else {}),
            **running.settings(),
            "COLUMNS": "200",
            "NO_COLOR": "1",
            **self.extra,
        }

    def url(self, service: str) -> str:
        """Return the base URL of a service."""
        return f"http://127.0.0.1:{self.ports[service]}"

    def log(self, service: str) -> str:
        """Return what a service has logged."""
        return self._log_file(service).read_text(errors="replace")

    def _log_file(self, service: str) -> Path:
        return self.data_dir / f"{service}.log"

    def start(self, *services: str, within_s: float = 30.0) -> None:
        """Start services and wait until each is ready."""
        if self.host and "context_broker" in services:
            self.host.start("context_broker")
            services = tuple(service for service in services if service != "context_broker")
        for service in services:
            self.spawn(service)
        for service in services:
            self.wait_ready(service, within_s)

    def spawn(self, service: str) -> None:
        """Start a service without waiting."""
        if service == "context_broker" and running.IS_OTHER:
            self.other_broker = self.other_broker or running.OtherBroker(self.ports[service], self.data_dir)
            self.processes[service] = self.other_broker.spawn(self.environment, self._log_file(service))
            return
        module = MODULES[service]
        self.processes[service] = processes.spawn_module(
            module, self.environment, self._log_file(service), self.data_dir
        )

    def run(self, *services: str) -> None:
        """Start those of the services that do not run."""
        self.start(*(service for service in services if not self.runs(service)))

    def runs(self, service: str) -> bool:
        """Return whether a service has been started and has not ended."""
        if self.host and service == "context_broker":
            return self.host.runs(service)
        process = self.processes.get(service)
        return process is not None and process.poll() is None

    def wait_ready(self, service: str, within_s: float = 30.0) -> None:
        """Wait until a service is ready."""
        process = self.processes.get(service)
        ready = f"{self.url(service)}{running.ready_path(service)}"
        processes.wait_ready(process, ready, lambda: self.log(service), within_s)

    def kill(self, service: str) -> None:
        """End a service as a power cut would."""
        if self.host and service == "context_broker":
            self.host.kill(service)
            return
        processes.kill(self.processes.pop(service))
        if service == "context_broker" and self.other_broker is not None:
            self.other_broker.kill()

    def restart(self, service: str) -> None:
        """End a service as a power cut would, and start it again."""
        self.kill(service)
        self.start(service)

    def stop(self) -> None:
        """End every service; kill those that do not end in time."""
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(scaled(10))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self.other_broker is not None:
            self.other_broker.stop()


@contextmanager
def new_cell(data_dir: Path) -> Iterator[Cell]:
    """Make a cell of which nothing runs yet; its processes are ended with the context."""
    cell = Cell(data_dir, {name: next_free_port() for name in SERVICES})
    try:
        yield cell
    finally:
        cell.stop()
