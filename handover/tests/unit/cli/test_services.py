"""Which services a cell has, as it is set."""

import os
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from handover.errors import UsageError
from handover.extensions import load_service
from handover.service_addresses import BROKER
from handover.services import let_broker_fetch_context, service_named, wanted_services

ALWAYS = (
    "context-broker",
    "task-orchestrator",
    "gesture-controller",
    "trajectory-tool",
    "device-gateway",
    "alert-router",
    "accounts",
    "study",
    "webui",
)

BELL = """
from handover.extensions import Service
from handover.settings import Settings

class BellSettings(Settings):
    bell_port: int = 54901

SERVICE = Service("bell", "chime_service", BellSettings, "bell_port")
"""


def names() -> tuple[str, ...]:
    return tuple(service.name for service in wanted_services())


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder without settings, from which packages are imported; human state lacks its packages."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HANDOVER_ROS_MAPPING", raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    body = load_service("human-state")
    monkeypatch.setattr("handover_body.settings.SERVICE", replace(body, needs=("no_such_package",)))
    return tmp_path


def install(folder: Path, distribution: str, entry: str) -> None:
    """Register an entry point of `handover.services` as an installed package does."""
    (folder / "chime_service.py").write_text(BELL)
    metadata = folder / f"{distribution}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[handover.services]\n{entry}\n")


def test_the_ros_bridge_belongs_to_a_cell_that_has_a_mapping_for_it(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    assert names() == ALWAYS
    monkeypatch.setenv("HANDOVER_ROS_MAPPING", "arm")
    assert names() == (*ALWAYS, "ros-bridge")


def test_human_state_belongs_to_a_cell_where_its_extra_is_installed(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    body = load_service("human-state")
    monkeypatch.setattr("handover_body.settings.SERVICE", replace(body, needs=("pydantic",)))
    assert names() == (*ALWAYS, "human-state")


def test_a_service_of_another_package_belongs_to_the_cell_by_its_entry_point(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    install(folder, "chime_service", "bell = chime_service:SERVICE")
    assert names() == (*ALWAYS, "bell")
    assert service_named("bell").url() == "http://127.0.0.1:54901"
    monkeypatch.setenv("HANDOVER_EXTRA_SERVICES", "")
    assert names() == ALWAYS
    monkeypatch.setenv("HANDOVER_EXTRA_SERVICES", "bell")
    assert names() == (*ALWAYS, "bell")


def test_a_package_that_cannot_be_imported_stops_the_cell_only_if_its_service_is_named(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    install(folder, "chime_service", "bell = no_such_module:SERVICE")
    assert names() == ALWAYS
    monkeypatch.setenv("HANDOVER_EXTRA_SERVICES", "bell")
    with pytest.raises(UsageError, match=r'service "bell".*cannot be loaded'):
        wanted_services()


def test_two_packages_that_register_one_name_are_named(folder: Path) -> None:
    install(folder, "chime_service", "bell = chime_service:SERVICE")
    install(folder, "study_of_others", "study = chime_service:SERVICE")
    with pytest.raises(UsageError, match=r'two packages register the service "study".*study_of_others'):
        wanted_services()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("url", "is_own"),
    [
        ("http://127.0.0.1:1026", True),
        ("http://localhost:1026", True),
        ("https://[::1]:1026", True),
        (f"http://{socket.gethostname()}:1026", True),
        ("http://127.0.0.1:1027", False),
        ("http://192.0.2.7:1026", False),
        ("https://orion.example.invalid:1026", False),
        ("https://orion.example.invalid", False),
    ],
)
def test_the_embedded_broker_belongs_to_a_cell_that_names_no_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object, url: str, is_own: bool
) -> None:
    monkeypatch.chdir(str(tmp_path))
    monkeypatch.setenv("HANDOVER_BROKER_URL", url)
    monkeypatch.setenv("HANDOVER_BROKER_PORT", "1026")
    monkeypatch.setenv("HANDOVER_ORCHESTRATOR_URL", "http://cell.example:54200")
    monkeypatch.setenv("HANDOVER_CONTEXT_URL", "")  # restored after the test
    monkeypatch.delenv("HANDOVER_CONTEXT_URL")
    assert (BROKER in {service.name for service in wanted_services()}) is is_own
    let_broker_fetch_context()
    address = os.environ.get("HANDOVER_CONTEXT_URL", "").partition("?")[0]
    assert address == ("" if is_own else "http://cell.example:54200/context.jsonld")
    monkeypatch.setenv("HANDOVER_CONTEXT_URL", "https://example.com/context.jsonld")
    let_broker_fetch_context()
    assert os.environ["HANDOVER_CONTEXT_URL"] == "https://example.com/context.jsonld"
