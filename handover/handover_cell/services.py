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

from handover.errors import UsageError
from handover.extensions import EXTRA_SERVICES, Service
from handover.outbound_policy import is_loopback
from handover.settings import Settings
from handover_accounts.settings import AccountsSettings
from handover_alerts.settings import RouterSettings
from handover_body.settings import HumanStateSettings
from handover_broker.settings import BrokerSettings
from handover_cases.settings import AssistiveSettings
from handover_datamodels.contexts import handover_context
from handover_devices.settings import GatewaySettings
from handover_gloves.settings import ControllerSettings
from handover_humanoid.settings import WholeBodySettings
from handover_processes.settings import OrchestratorSettings
from handover_robots.settings import TrajectorySettings
from handover_ros.settings import BridgeSettings
from handover_study.settings import StudySettings
from handover_web.settings import WebuiSettings

if TYPE_CHECKING:
    from fastapi import FastAPI

BROKER = "context-broker"
SERVICES = (
    Service(BROKER, "handover_broker", BrokerSettings, "broker_port"),
    Service("task-orchestrator", "handover_processes", OrchestratorSettings, "orchestrator_port"),
    Service(
        "gesture-controller",
        "handover_gloves",
        ControllerSettings,
        "controller_port",
        (("glove_host", "glove_port"),),
    ),
    Service("trajectory-tool", "handover_robots", TrajectorySettings, "trajectory_port"),
    Service(
        "device-gateway",
        "handover_devices",
        GatewaySettings,
        "gateway_port",
        (("device_host", "device_port"),),
    ),
    Service("alert-router", "handover_alerts", RouterSettings, "alert_router_port"),
    Service("accounts", "handover_accounts", AccountsSettings, "accounts_port"),
    Service("study", "handover_study", StudySettings, "study_port"),
    Service("webui", "handover_web", WebuiSettings, "webui_port"),
)
HUMAN_STATE = Service("human-state", "handover_body", HumanStateSettings, "human_state_port")
HUMAN_STATE_NEEDS = ("numpy", "scipy", "neurokit2")
"""Packages of the extra `human-state`, without which the service cannot start."""
ASSISTIVE_DEVICES = Service("assistive-devices", "handover_cases", AssistiveSettings, "assistive_port")
WHOLE_BODY_CONTROL = Service("whole-body-control", "handover_humanoid", WholeBodySettings, "whole_body_port")
ROS_BRIDGE = Service("ros-bridge", "handover_ros", BridgeSettings, "bridge_port")
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
