"""Observability: Prometheus asks every service where it listens, the dashboard for what they count."""

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import REGISTRY

from handover.cli.services import OPTIONAL_SERVICES, SERVICES

HERE = Path(__file__).parents[3] / "deploy" / "observability"
DASHBOARD: dict[str, Any] = json.loads((HERE / "dashboards" / "handover.json").read_text())
COUNTING = (
    "ros_fiware_bridge.metrics",
    "services.context_broker.app",
    "services.gesture_controller.metrics",
    "services.task_orchestrator.app",
    "services.trajectory_tool.metrics",
    "webui.metrics",
)
"""The modules that register what is counted, some by what they import."""

SUFFIXES = {"counter": ["_total"], "histogram": ["_bucket", "_count", "_sum"], "gauge": [""]}
OF_PROMETHEUS = {"up"}
METRIC = re.compile(r"\b(?:handover|process)_[a-z0-9_]+|\bup\b")


def counted() -> set[str]:
    """Return the names of all series that the services can show."""
    for module in COUNTING:
        importlib.import_module(module)
    return {
        f"{family.name}{suffix}" for family in REGISTRY.collect() for suffix in SUFFIXES.get(family.type, [])
    }


def questions() -> Iterator[tuple[str, str]]:
    for panel in DASHBOARD["panels"]:
        for target in panel["targets"]:
            yield panel["title"], target["expr"]


@pytest.mark.parametrize(("panel", "expression"), list(questions()))
def test_a_panel_asks_for_what_is_counted(panel: str, expression: str) -> None:
    asked = set(METRIC.findall(expression))
    assert asked, f"{panel} asks for nothing that is ours"
    assert asked <= counted() | OF_PROMETHEUS


@pytest.mark.parametrize(
    "name",
    [
        "handover_orchestrator_tasks_open",
        "handover_orchestrator_oldest_task_age_seconds",
        "handover_orchestrator_hold_to_robot_seconds_bucket",
        "handover_gesture_controller_gloves_connected",
        "handover_gesture_controller_frames_received_total",
        "handover_broker_notifications_pending",
        "up",
    ],
)
def test_dashboard_shows_the_important_metrics(name: str) -> None:
    assert any(name in METRIC.findall(expression) for _, expression in questions())


def test_prometheus_asks_every_service_where_it_listens() -> None:
    jobs = yaml.safe_load((HERE / "prometheus.yml").read_text())["scrape_configs"]
    asked = {job["job_name"]: job["static_configs"][0]["targets"] for job in jobs if "static_configs" in job}
    assert asked == {
        service.name: [f"{service.name}:{service.settings.model_fields[service.port_field].default}"]
        for service in SERVICES
    }


@pytest.mark.parametrize(
    ("name", "profile"),
    [
        ("ros-bridge", "ros"),
        ("human-state", "human-state"),
        ("assistive-devices", "assistive-devices"),
        ("whole-body-control", "whole-body-control"),
    ],
)
def test_prometheus_asks_a_service_of_a_profile_where_there_is_one(name: str, profile: str) -> None:
    jobs = yaml.safe_load((HERE / "prometheus.yml").read_text())["scrape_configs"]
    (job,) = [job for job in jobs if job["job_name"] == name]
    (found,) = job["dns_sd_configs"]
    compose = yaml.safe_load((HERE.parents[1] / "docker-compose.yml").read_text())
    assert compose["services"][found["names"][0]]["profiles"] == [profile]
    (service,) = (one for one in OPTIONAL_SERVICES if one.name == name)
    assert found["port"] == service.settings.model_fields[service.port_field].default


def test_the_dashboard_asks_the_source_that_is_provisioned() -> None:
    sources = yaml.safe_load((HERE / "grafana" / "datasources" / "prometheus.yml").read_text())
    (source,) = sources["datasources"]
    assert source["url"] == "http://prometheus:9090"
    for panel in DASHBOARD["panels"]:
        assert panel["datasource"]["uid"] == source["uid"]


def test_panels_do_not_lie_on_each_other() -> None:
    taken: dict[tuple[int, int], str] = {}
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24
        for x in range(place["x"], place["x"] + place["w"]):
            for y in range(place["y"], place["y"] + place["h"]):
                assert taken.setdefault((x, y), panel["title"]) == panel["title"]
