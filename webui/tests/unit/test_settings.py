"""The settings: URLs of services, the host for gloves, the emergency stop."""

import pytest

from handover_web.app import cell_view
from handover_web.settings import WebuiSettings


@pytest.fixture(autouse=True)
def _no_settings_of_this_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.chdir(str(tmp_path))


@pytest.mark.parametrize(
    ("glove_host", "controller_url", "reached_at"),
    [
        ("127.0.0.1", None, "127.0.0.1"),
        ("0.0.0.0", None, "127.0.0.1"),
        ("0.0.0.0", "http://gesture-controller:54210", "gesture-controller"),
        ("192.168.7.20", None, "192.168.7.20"),
        ("localhost", None, "127.0.0.1"),
        ("gloves.hall.example", None, "gloves.hall.example"),
    ],
)
def test_the_glove_server_host(glove_host: str, controller_url: str | None, reached_at: str) -> None:
    settings = WebuiSettings.load(glove_host=glove_host, controller_url=controller_url)
    assert settings.glove_server_host == reached_at


def test_every_service_has_a_url() -> None:
    urls = WebuiSettings.load(
        broker_url="http://orion:1026", orchestrator_url="http://orchestrator:54200/"
    ).service_urls
    assert urls["context-broker"] == "http://orion:1026"
    assert urls["task-orchestrator"] == "http://orchestrator:54200"
    assert urls["trajectory-tool"] == "http://127.0.0.1:54220"
    assert urls["device-gateway"] == "http://127.0.0.1:54240"
    assert urls["alert-router"] == "http://127.0.0.1:54280"
    assert urls["study"] == "http://127.0.0.1:54270"
    assert urls["human-state"] == "http://127.0.0.1:54250"


def test_the_ros_bridge_has_a_url_if_a_mapping_is_set() -> None:
    assert "ros-bridge" not in WebuiSettings.load().service_urls
    assert WebuiSettings.load(ros_mapping="arm").service_urls["ros-bridge"] == "http://127.0.0.1:54100"


def test_the_location_of_the_emergency_stop_is_published() -> None:
    assert "emergencyStop" not in cell_view(WebuiSettings.load())
    assert "emergencyStop" not in cell_view(WebuiSettings.load(emergency_stop=""))
    view = cell_view(WebuiSettings.load(emergency_stop="the grey cord over the bench"))
    assert view["emergencyStop"] == "the grey cord over the bench"
