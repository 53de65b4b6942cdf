"""Imports by the names that modules had before each part got an import package and folders, until 1.0.

`handover_renamed_modules.pth` asks `find_spec` for names that begin like an old one, before other finders: in
a checkout, these would find folders such as `datamodels` and `services` as namespace packages. For modules of
the kit, it is asked after other finders (`handover/__init__.py`). What else has such a name is preferred: a
package or module of the user, and what a namespace package of the user contains.

An old name is the module of the new name, the same object, so that its classes are the same too:

    from datamodels import Task                         # handover_datamodels
    from services.trajectory_tool.robots import ROBOTS  # handover_robots.robots

Each renamed package, and each module that has moved into a folder, raises one `DeprecationWarning`, at the
first import by its old name.
"""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import InspectLoader
from importlib.machinery import ModuleSpec
from importlib.util import find_spec as find_module
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, Final

RENAMED: Final = {
    "datamodels": "handover_datamodels",
    "handover.cli": "handover_cell",
    "ros_fiware_bridge": "handover_ros",
    "services.accounts": "handover_accounts",
    "services.alert_router": "handover_alerts",
    "services.assistive_devices": "handover_cases",
    "services.context_broker": "handover_broker",
    "services.device_gateway": "handover_devices",
    "services.gesture_controller": "handover_gloves",
    "services.human_state": "handover_body",
    "services.study": "handover_study",
    "services.task_orchestrator": "handover_processes",
    "services.trajectory_tool": "handover_robots",
    "services.whole_body_control": "handover_humanoid",
    "webui": "handover_web",
}
"""The packages by their old names."""
MOVED: Final = {
    "handover.alert_catalogue": "handover.alerts.catalogue",
    "handover.api_description": "handover.http.api_description",
    "handover.api_docs": "handover.http.api_docs",
    "handover.background_tasks": "handover.runtime.background_tasks",
    "handover.body_limit": "handover.http.body_limit",
    "handover.broker_abilities": "handover.broker.abilities",
    "handover.broker_credentials": "handover.broker.credentials",
    "handover.broker_identity": "handover.broker.identity",
    "handover.cells": "handover.broker.cells",
    "handover.certificate_watch": "handover.serving.certificate_watch",
    "handover.client_networks": "handover.network.client_networks",
    "handover.clocks": "handover.runtime.clocks",
    "handover.content_digest": "handover.files.content_digest",
    "handover.control_leasing": "handover.control.leasing",
    "handover.control_session": "handover.control.session",
    "handover.database_outage": "handover.database.outage",
    "handover.device_lease": "handover.tasks.device_lease",
    "handover.durable_files": "handover.files.durable_files",
    "handover.durations": "handover.formats.durations",
    "handover.event_log": "handover.tasks.event_log",
    "handover.finished_tasks": "handover.tasks.finished_tasks",
    "handover.folder_lock": "handover.files.folder_lock",
    "handover.free_values": "handover.formats.free_values",
    "handover.garbage_collection": "handover.runtime.garbage_collection",
    "handover.http_client": "handover.network.http_client",
    "handover.http_protocol": "handover.http.protocol",
    "handover.latest_value_writer": "handover.broker.latest_value_writer",
    "handover.leadership": "handover.serving.leadership",
    "handover.log_files": "handover.logs.log_files",
    "handover.mcap_files": "handover.formats.mcap_files",
    "handover.migrations": "handover.database.migrations",
    "handover.notifications": "handover.subscriptions.notifications",
    "handover.offload": "handover.runtime.offload",
    "handover.origin_guard": "handover.http.origin_guard",
    "handover.outbound_policy": "handover.network.outbound_policy",
    "handover.outcomes": "handover.tasks.outcomes",
    "handover.own_subscriptions": "handover.subscriptions.own_subscriptions",
    "handover.ports": "handover.runtime.ports",
    "handover.private_files": "handover.files.private_files",
    "handover.python_processes": "handover.runtime.python_processes",
    "handover.repeated_lines": "handover.logs.repeated_lines",
    "handover.reporting_writer": "handover.alerts.reporting_writer",
    "handover.resync": "handover.broker.resync",
    "handover.retry": "handover.runtime.retry",
    "handover.robot_xml": "handover.formats.robot_xml",
    "handover.ros_dds": "handover.formats.ros_dds",
    "handover.security.audit_chains": "handover.security.audit_reading.audit_chains",
    "handover.security.audit_routes": "handover.security.audit_reading.audit_routes",
    "handover.security.performer_proof": "handover.security.proofs.performer_proof",
    "handover.security.pin_check": "handover.security.proofs.pin_check",
    "handover.service": "handover.serving.service",
    "handover.specification": "handover.tasks.specification",
    "handover.specification_table": "handover.tasks.specification_table",
    "handover.sqlite_files": "handover.database.sqlite_files",
    "handover.sqlite_integrity": "handover.database.sqlite_integrity",
    "handover.storage": "handover.serving.storage",
    "handover.strict_json": "handover.formats.strict_json",
    "handover.subscription_record": "handover.subscriptions.record",
    "handover.tables": "handover.formats.tables",
    "handover.task_life": "handover.tasks.task_life",
    "handover.tls_trust": "handover.network.tls_trust",
    "handover.validation": "handover.formats.validation",
    "handover.watchdog": "handover.serving.watchdog",
    "handover.websocket_closing": "handover.http.websocket_closing",
    "handover_cell.commands": "handover.command_line.commands",
    "handover_cell.main": "handover.command_line.main",
    "handover_cell.services": "handover.services",
    "handover_processes.execution": "handover_bpmn.execution",
    "handover_processes.forms": "handover_bpmn.forms",
    "handover_processes.forms.registry": "handover_processes.deployed_forms",
    "handover_processes.languages": "handover_bpmn.languages",
    "handover_processes.lookahead": "handover_bpmn.lookahead",
    "handover_processes.model": "handover_bpmn.model",
    "handover_processes.notation": "handover_bpmn.notation",
    "handover_processes.timing.due_queue": "handover_bpmn.timing.due_queue",
    "handover_processes.timing.spans": "handover_bpmn.spans",
    "handover_processes.timing.timers": "handover_bpmn.timing.timers",
    "handover_broker.federation": "handover_federation",
    "handover_broker.snapshots": "handover_federation.snapshots",
    "handover_robots.contents": "handover_robots.scene.contents",
    "handover_robots.cycles": "handover_robots.driver_base.control_thread",
    "handover_robots.cyclic_robot": "handover_robots.driver_base.cyclic_robot",
    "handover_robots.joint_trajectory": "handover_robots.model.joint_trajectory",
    "handover_robots.obstacles": "handover_robots.model.obstacles",
    "handover_robots.poses": "handover_robots.model.poses",
    "handover_robots.position_file": "handover_robots.driver_base.position_file",
    "handover_robots.robot": "handover_robots.driver_base.robot",
    "handover_robots.robot_model": "handover_robots.robots.urdf",
    "handover_robots.simulated_robot": "handover_robots.drivers.simulated_robot",
    "handover_robots.trajectory": "handover_robots.model.trajectory",
    "handover_robots.universal_robots": "handover_ur",
    "handover_robots.vision": "handover_robots.scene.vision",
}
"""The modules that other packages import, by their old names in the new packages."""
PARENT: Final = "services"
"""The old package that had nothing but packages."""

FOLDERS: Final = {
    name.replace(".", "/"): f"{'handover' if name == 'handover.cli' else name.replace('.', '/')}/{new}"
    for name, new in RENAMED.items()
}
"""The folders of a checkout by their old names."""

_OLD_ROOTS: Final = {old for old in RENAMED if "." not in old} | {PARENT}
_OLD_BEGINNINGS: Final = {".".join(old.split(".")[:2]) for old in (*RENAMED, *MOVED)}
_warned: set[str] = set()


def moved_file(path: Path) -> Path:
    """Return the present place of a shipped file that is named by its old place; any other path as it is."""
    if path.exists():
        return path
    for old, new in FOLDERS.items():
        before, separator, after = path.as_posix().rpartition(f"{old}/")
        moved = Path(f"{before}{new}/{after}")
        if separator and before[-1:] in {"", "/"} and moved.exists():
            warnings.warn(
                f"{path} is now {moved}; set that, the old path works until Handover 1.0",
                FutureWarning,  # shown to users, other than DeprecationWarning
                stacklevel=2,
            )
            return moved
    return path


def new_name(name: str) -> str | None:
    """Return the new name of a module; None if `name` is no old name."""
    root, _, below = name.partition(".")
    if root not in _OLD_ROOTS and f"{root}.{below.partition('.')[0]}" not in _OLD_BEGINNINGS:
        return None  # soon, since most modules have their names
    part = _renamed_part(name)
    return None if part is None else part[1] + name[len(part[0]) :]


def _renamed_part(name: str) -> tuple[str, str] | None:
    """Return the longest beginning of `name` that has a new name, and that name; None without one."""
    package = name
    while package:
        present = next(
            (new + package[len(old) :] for old, new in RENAMED.items() if _is_in(package, old)), None
        )
        new = MOVED.get(present or package) or (present if package in RENAMED else None)
        if new is not None:
            return package, new
        package = package.rpartition(".")[0]
    return None


def _is_in(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def find_spec(
    name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
) -> ModuleSpec | None:
    """Return how to import a module by its old name; None if the name is not ours or nothing has it."""
    new = new_name(name)
    if new is None and name != PARENT:
        return None
    parent = name.rpartition(".")[0]
    if not _is_renamed(parent):
        other = _found_by_others(name, path, target)
        if other is not None and not _is_checkout(other) and not _is_left_behind(other, parent):
            return other
        if parent and not _may_have_ours(parent):
            return None
    if new is None:
        return ModuleSpec(name, _Parent(), is_package=True)
    spec = find_module(new)
    if spec is None:
        return None
    is_package = spec.submodule_search_locations is not None
    return ModuleSpec(name, _Renamed(new), origin=spec.origin, is_package=is_package)


def _is_renamed(parent: str) -> bool:
    """Return whether `parent` was imported by an old name: then its modules are not those of its folder."""
    module, new = sys.modules.get(parent), new_name(parent)
    return module is not None and new is not None and module is sys.modules.get(new)


def _is_ours(package: str) -> bool:
    return package == "handover" or any(name.startswith(f"{package}.") for name in MOVED)


def _may_have_ours(parent: str) -> bool:
    """Return whether our modules are beside those of the user: in our packages, and in namespace packages."""
    return _is_ours(parent) or _is_namespace(parent)


def _is_namespace(package: str) -> bool:
    return getattr(sys.modules.get(package), "__file__", None) is None


def _is_left_behind(spec: ModuleSpec, parent: str) -> bool:
    """Return whether a folder of one of our packages has nothing but what an earlier checkout compiled."""
    return spec.loader is None and _is_ours(parent) and not _is_namespace(parent)


def _is_checkout(spec: ModuleSpec) -> bool:
    """Return whether a namespace package is a folder of a checkout, which has the new packages in it."""
    if spec.loader is not None or spec.submodule_search_locations is None:
        return False
    inside = RENAMED.get(spec.name, "*/handover_*")
    return all(any(Path(folder).glob(f"{inside}/__init__.py")) for folder in spec.submodule_search_locations)


def _found_by_others(name: str, path: Sequence[str] | None, target: ModuleType | None) -> ModuleSpec | None:
    for finder in sys.meta_path:
        if not getattr(finder, "finds_renamed_modules", False):
            spec: ModuleSpec | None = finder.find_spec(name, path, target)
            if spec is not None:
                return spec
    return None


class _Parent(InspectLoader):
    """Loads the package `services`, which is empty."""

    def get_source(self, fullname: str) -> str:  # noqa: ARG002 - the interface of loaders
        return ""

    def is_package(self, fullname: str) -> bool:  # noqa: ARG002 - the interface of loaders
        return True


class _Renamed(InspectLoader):
    """Loads a module by its old name: puts the module of the new name in its place."""

    def __init__(self, new: str) -> None:
        self._new = new

    def exec_module(self, module: ModuleType) -> None:
        name = module.__name__
        old, new = _renamed_part(name) or (name, self._new)
        if old not in _warned:
            _warned.add(old)
            warnings.warn(
                f"{old} is now {new}; import that, the old name works until Handover 1.0",
                DeprecationWarning,
                stacklevel=2,
            )
        sys.modules[name] = import_module(self._new)

    def get_code(self, fullname: str) -> CodeType | None:  # noqa: ARG002 - for `python -m`
        loader = self._loader()
        return loader.get_code(self._new) if isinstance(loader, InspectLoader) else None

    def get_source(self, fullname: str) -> str | None:  # noqa: ARG002 - the interface of loaders
        loader = self._loader()
        return loader.get_source(self._new) if isinstance(loader, InspectLoader) else None

    def _loader(self) -> Any:
        spec = find_module(self._new)
        return spec.loader if spec is not None else None
