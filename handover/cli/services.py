"""The services of a cell, as the command line knows them: name, module and port."""

from collections.abc import Iterator
from dataclasses import dataclass

from handover.errors import UsageError
from handover.settings import Settings
from ros_fiware_bridge.settings import BridgeSettings
from services.context_broker.settings import BrokerSettings
from services.gesture_controller.settings import ControllerSettings
from services.task_orchestrator.settings import OrchestratorSettings
from services.trajectory_tool.settings import TrajectorySettings
from webui.settings import WebuiSettings


@dataclass(frozen=True, slots=True)
class Service:
    """One service; `port_field` is the setting that says where it answers HTTP."""

    name: str
    module: str
    settings: type[Settings]
    port_field: str
    also_listens: tuple[tuple[str, str], ...] = ()
    """More places where it listens: the settings that say the host and the port."""

    @property
    def port_setting(self) -> str:
        """Return the name of the environment variable that sets the port."""
        return f"HANDOVER_{self.port_field.upper()}"

    def port(self) -> int:
        """Return the port it listens on."""
        return int(getattr(self.settings.load(), self.port_field))

    def listens(self) -> Iterator[tuple[str, int, str]]:
        """Yield every host and port it listens on, with the environment variable that sets the port."""
        loaded = self.settings.load()
        for host_field, port_field in (("host", self.port_field), *self.also_listens):
            host, port = getattr(loaded, host_field), getattr(loaded, port_field)
            yield str(host), int(port), f"HANDOVER_{port_field.upper()}"

    def url(self) -> str:
        """Return where it answers on this machine."""
        return self.settings.load().url_of(self.port())


SERVICES = (
    Service("context-broker", "services.context_broker", BrokerSettings, "broker_port"),
    Service("task-orchestrator", "services.task_orchestrator", OrchestratorSettings, "orchestrator_port"),
    Service(
        "gesture-controller",
        "services.gesture_controller",
        ControllerSettings,
        "controller_port",
        (("glove_host", "glove_port"),),
    ),
    Service("trajectory-tool", "services.trajectory_tool", TrajectorySettings, "trajectory_port"),
    Service("webui", "webui", WebuiSettings, "webui_port"),
)
ROS_BRIDGE = Service("ros-bridge", "ros_fiware_bridge", BridgeSettings, "bridge_port")
BESIDES = (ROS_BRIDGE,)
"""Services that are run where they are wanted."""


def wanted() -> tuple[Service, ...]:
    """Return the services of the cell as it is set: the ROS bridge is one of them if it has a mapping."""
    return (*SERVICES, ROS_BRIDGE) if BridgeSettings.load().ros_mapping is not None else SERVICES


def service_named(name: str) -> Service:
    """Return the service called `name`; raise `UsageError` with the names there are."""
    for service in (*SERVICES, *BESIDES):
        if service.name == name:
            return service
    known = ", ".join(service.name for service in (*SERVICES, *BESIDES))
    raise UsageError(f'there is no service "{name}"; the services are {known}')
