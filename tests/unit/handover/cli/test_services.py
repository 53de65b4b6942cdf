"""Which services a cell has, as it is set."""

import os
import socket

import pytest

from handover_cell.services import BROKER, SERVICES, let_broker_fetch_context, service_named, wanted


def test_the_ros_bridge_belongs_to_a_cell_that_has_a_mapping_for_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.chdir(str(tmp_path))
    monkeypatch.delenv("HANDOVER_ROS_MAPPING", raising=False)
    monkeypatch.setattr("handover_cell.services.HUMAN_STATE_NEEDS", ("a_package_that_is_not_there",))
    assert wanted() == SERVICES
    monkeypatch.setenv("HANDOVER_ROS_MAPPING", "arm")
    assert wanted() == (*SERVICES, service_named("ros-bridge"))


def test_human_state_belongs_to_a_cell_where_its_extra_is_installed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.chdir(str(tmp_path))
    monkeypatch.delenv("HANDOVER_ROS_MAPPING", raising=False)
    monkeypatch.setattr("handover_cell.services.HUMAN_STATE_NEEDS", ("pydantic",))
    assert wanted() == (*SERVICES, service_named("human-state"))


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
    assert (BROKER in {service.name for service in wanted()}) is is_own
    let_broker_fetch_context()
    address = os.environ.get("HANDOVER_CONTEXT_URL", "").partition("?")[0]
    assert address == ("" if is_own else "http://cell.example:54200/context.jsonld")
    monkeypatch.setenv("HANDOVER_CONTEXT_URL", "https://example.com/context.jsonld")
    let_broker_fetch_context()
    assert os.environ["HANDOVER_CONTEXT_URL"] == "https://example.com/context.jsonld"
