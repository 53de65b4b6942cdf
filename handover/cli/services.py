"""The services of a cell: name, module and port."""

import importlib
import json
import os
import socket
from contextlib import suppress
from hashlib import sha256
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from datamodels.contexts import handover_context
from handover.errors import UsageError
from handover.extensions import EXTRA_SERVICES, Service
from handover.outbound_policy import is_loopback
from handover.settings import Settings
from ros_fiware_bridge.settings import BridgeSettings
from services.accounts.settings import AccountsSettings
from services.alert_router.settings import RouterSettings
from services.assistive_devices.settings import AssistiveSettings
from services.context_broker.settings import BrokerSettings
from services.device_gateway.settings import GatewaySettings
from services.gesture_controller.settings import ControllerSettings
from services.human_state.settings import HumanStateSettings
from services.study.settings import StudySettings
from services.task_orchestrator.settings import OrchestratorSettings
from services.trajectory_tool.settings import TrajectorySettings
from services.whole_body_control.settings import WholeBodySettings
from webui.settings import WebuiSettings

if TYPE_CHECKING:
    from fastapi import FastAPI

BROKER = "context-broker"
SERVICES = (
    Service(BROKER, "services.context_broker", BrokerSettings, "broker_port"),
    Service("task-orchestrator", "services.task_orchestrator", OrchestratorSettings, "orchestrator_port"),
    Service(
        "gesture-controller",
        "services.gesture_controller",
        ControllerSettings,
        "controller_port",
        (("glove_host", "glove_port"),),
    ),
    Service("trajectory-tool", "services.trajectory_tool", TrajectorySettings, "trajectory_port"),
    Service(
        "device-gateway",
        "services.device_gateway",
        GatewaySettings,
        "gateway_port",
        (("device_host", "device_port"),),
    ),
    Service("alert-router", "services.alert_router", RouterSettings, "alert_router_port"),
    Service("accounts", "services.accounts", AccountsSettings, "accounts_port"),
    Service("study", "services.study", StudySettings, "study_port"),
    Service("webui", "webui", WebuiSettings, "webui_port"),
)
HUMAN_STATE = Service("human-state", "services.human_state", HumanStateSettings, "human_state_port")
HUMAN_STATE_NEEDS = ("numpy", "scipy", "neurokit2")
"""Packages of the extra `human-state`, without which the service cannot start."""
ASSISTIVE_DEVICES = Service(
    "assistive-devices", "services.assistive_devices", AssistiveSettings, "assistive_port"
)
WHOLE_BODY_CONTROL = Service(
    "whole-body-control", "services.whole_body_control", WholeBodySettings, "whole_body_port"
)
ROS_BRIDGE = Service("ros-bridge", "ros_fiware_bridge", BridgeSettings, "bridge_port")
OPTIONAL_SERVICES = (HUMAN_STATE, ASSISTIVE_DEVICES, WHOLE_BODY_CONTROL, ROS_BRIDGE)
"""Services that start only with an extra or a setting."""


def has_own_broker() -> bool:
    """Return whether the broker of the settings is the embedded one: at its port of this machine."""
    url, port = urlsplit(Settings.load().broker_url), BrokerSettings.load().broker_port
    return (url.port or (443 if url.scheme == "https" else 80)) == port and _is_here(url.hostname or "")


def let_broker_fetch_context() -> None:
    """Name the @context of our orchestrator to another broker, unless a setting says which one.

    Our own broker has the @context of the default address. Others may keep for ever what they have fetched,
    so the address differs with the content.
    """
    if not has_own_broker() and "context_url" not in Settings.load().model_fields_set:
        digest = sha256(json.dumps(handover_context()).encode()).hexdigest()[:12]
        os.environ["HANDOVER_CONTEXT_URL"] = f"{OrchestratorSettings.load().own_url}/context.jsonld?{digest}"


def _is_here(host: str) -> bool:
    """Return whether a host is this machine: an address is its own if a socket can be bound to it."""
    if is_loopback(host):
        return True
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_DGRAM)
    except OSError:
        return False
    for family, kind, _, _, address in found:
        with socket.socket(family, kind) as one, suppress(OSError):
            one.bind(address)
            return True
    return False


def wanted() -> tuple[Service, ...]:
    """Return the services of the cell.

    The embedded broker runs unless the settings name another one, human state with its extra, assistive
    devices with a machine, whole-body control with a humanoid, the bridge with a mapping.
    """
    body = (HUMAN_STATE,) if all(map(find_spec, HUMAN_STATE_NEEDS)) else ()
    bridge = (ROS_BRIDGE,) if BridgeSettings.load().ros_mapping is not None else ()
    devices = (ASSISTIVE_DEVICES,) if AssistiveSettings.load().assistive_machines else ()
    humanoid = (WHOLE_BODY_CONTROL,) if WholeBodySettings.load().humanoid_model else ()
    cell = [one for one in SERVICES if one.name != BROKER or has_own_broker()]
    return (*cell, *body, *devices, *humanoid, *bridge, *map(_extra, Settings.load().extra_services))


def all_services() -> tuple[Service, ...]:
    """Return every service that can be run, those of other packages too."""
    return (*SERVICES, *OPTIONAL_SERVICES, *map(_extra, EXTRA_SERVICES.names()))


def service_named(name: str) -> Service:
    """Return the service called `name`; raise `UsageError` with the known names."""
    for service in (*SERVICES, *OPTIONAL_SERVICES):
        if service.name == name:
            return service
    if name in EXTRA_SERVICES.names():
        return _extra(name)
    known = ", ".join((*(one.name for one in (*SERVICES, *OPTIONAL_SERVICES)), *EXTRA_SERVICES.names()))
    raise UsageError(f'there is no service "{name}"; the services are {known}')


def application_of(service: Service) -> "FastAPI | None":
    """Return the application of a service with the present settings; None if FastAPI does not answer it."""
    from fastapi import FastAPI  # noqa: PLC0415 - the command line starts without it

    for module in ("app", "server"):
        try:
            make = getattr(importlib.import_module(f"{service.module}.{module}"), "make_app", None)
        except ModuleNotFoundError:
            continue
        if make is not None:
            made: Any = make(service.settings.load())
            while not isinstance(made, FastAPI):  # a wrapper of the application
                made = next(value for name, value in vars(made).items() if name.lstrip("_") == "app")
            return made
    return None


def _extra(name: str) -> Service:
    service = EXTRA_SERVICES.load(name)
    if not isinstance(service, Service):
        raise UsageError(
            f'the entry point "{name}" in "{EXTRA_SERVICES.group}" is no handover.extensions.Service; '
            "correct it in the package that registers it"
        )
    return service
