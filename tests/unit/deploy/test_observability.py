"""Observability: Prometheus asks every service where it listens, the dashboard for what they count."""

import importlib
import json
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import yaml
from jsonschema import validate
from prometheus_client import REGISTRY

from docs.site.reference import metrics
from handover.services import own_services
from tests.kit.paths import REPOSITORY

HERE = REPOSITORY / "deploy" / "observability"
DASHBOARD: dict[str, Any] = json.loads((HERE / "dashboards" / "handover.json").read_text())
COUNTING = (
    "handover_ros.metrics",
    "handover_alerts.metrics",
    "handover_broker.app",
    "handover_devices.metrics",
    "handover_gloves.metrics",
    "handover_processes.app",
    "handover_robots.metrics",
    "handover_web.metrics",
)
"""The modules that register what is counted, some by what they import."""

SUFFIXES = {"counter": ["_total"], "histogram": ["_bucket", "_count", "_sum"], "gauge": [""]}
OF_PROMETHEUS = {"up"}
METRIC = re.compile(r"\b(?:handover|process)_[a-z0-9_]+|\bup\b")


TEXT = {"type": "string", "minLength": 1}
RULES_SCHEMA = {
    "type": "object",
    "required": ["groups"],
    "additionalProperties": False,
    "properties": {
        "groups": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["name", "rules"],
                "additionalProperties": False,
                "properties": {
                    "name": TEXT,
                    "rules": {
                        "type": "array",
                        "minItems": 1,
                        "items": {
                            "type": "object",
                            "required": ["alert", "expr", "labels", "annotations"],
                            "additionalProperties": False,
                            "properties": {
                                "alert": {"type": "string", "pattern": "^Handover[A-Za-z]+$"},
                                "expr": TEXT,
                                "for": {"type": "string", "pattern": "^[1-9][0-9]*[smh]$"},
                                "labels": {
                                    "type": "object",
                                    "required": ["severity"],
                                    "additionalProperties": False,
                                    "properties": {"severity": {"enum": ["warning", "critical"]}},
                                },
                                "annotations": {
                                    "type": "object",
                                    "required": ["summary", "remedy"],
                                    "additionalProperties": TEXT,
                                },
                            },
                        },
                    },
                },
            },
        }
    },
}
"""The part of the format of Prometheus' rule files that ours use."""

RULES: dict[str, Any] = yaml.safe_load((HERE / "alerts.yml").read_text())
LABELS_OF_A_TARGET = {"job", "instance"}
LABEL = re.compile(r"[{,]\s*([a-z_]+)\s*[=!]|\$labels\.([a-z_]+)")
GROUPING = re.compile(r"\bby \(([a-z_, ]+)\)")


@cache
def labels_of() -> dict[str, tuple[str, ...]]:
    """Return the labels of each metric by its name."""
    return {name: labels for name, _, labels, _ in metrics()}


@cache
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


PROFILES = {
    "ros-bridge": "ros",
    "human-state": "human-state",
    "assistive-devices": "assistive-devices",
    "whole-body-control": "whole-body-control",
}
"""The profile of Compose in which a service runs, where it does not always."""


def test_prometheus_asks_every_service_where_it_listens() -> None:
    jobs = yaml.safe_load((HERE / "prometheus.yml").read_text())["scrape_configs"]
    asked = {job["job_name"]: job["static_configs"][0]["targets"] for job in jobs if "static_configs" in job}
    assert asked == {
        service.name: [f"{service.name}:{service.settings.model_fields[service.port_field].default}"]
        for service in own_services()
        if service.name not in PROFILES
    }


@pytest.mark.parametrize(("name", "profile"), PROFILES.items())
def test_prometheus_asks_a_service_of_a_profile_where_there_is_one(name: str, profile: str) -> None:
    jobs = yaml.safe_load((HERE / "prometheus.yml").read_text())["scrape_configs"]
    (job,) = [job for job in jobs if job["job_name"] == name]
    (found,) = job["dns_sd_configs"]
    compose = yaml.safe_load((HERE.parents[1] / "docker-compose.yml").read_text())
    assert compose["services"][found["names"][0]]["profiles"] == [profile]
    (service,) = (service for service in own_services() if service.name == name)
    assert found["port"] == service.settings.model_fields[service.port_field].default


def test_the_dashboard_asks_the_source_that_is_provisioned() -> None:
    sources = yaml.safe_load((HERE / "grafana" / "datasources" / "prometheus.yml").read_text())
    (source,) = sources["datasources"]
    assert source["url"] == "http://prometheus:9090"
    for panel in DASHBOARD["panels"]:
        assert panel["datasource"]["uid"] == source["uid"]


def rules() -> list[dict[str, Any]]:
    return [rule for group in RULES["groups"] for rule in group["rules"]]


def test_alert_rules_have_the_format_of_prometheus() -> None:
    validate(RULES, RULES_SCHEMA)
    names = [rule["alert"] for rule in rules()]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("rule", rules(), ids=lambda rule: rule["alert"])
def test_an_alert_rule_asks_for_metrics_and_labels_that_services_have(rule: dict[str, Any]) -> None:
    names = set(METRIC.findall(rule["expr"]))
    assert names, "the rule asks for nothing that is ours"
    assert names <= counted() | OF_PROMETHEUS
    has = LABELS_OF_A_TARGET.union(*(labels_of()[name] for name in names - OF_PROMETHEUS))
    texts = " ".join([rule["expr"], *rule["annotations"].values()])
    asked = {label for pair in LABEL.findall(texts) for label in pair if label}
    for group in GROUPING.findall(rule["expr"]):
        kept = {label.strip() for label in group.split(",")}
        asked |= kept
        shown = {label for _, label in LABEL.findall(" ".join(rule["annotations"].values())) if label}
        assert shown <= kept, "a label that the sum drops is empty in the message"
    assert asked <= has


def test_prometheus_loads_the_alert_rules() -> None:
    (name,) = yaml.safe_load((HERE / "prometheus.yml").read_text())["rule_files"]
    compose = yaml.safe_load((HERE.parents[1] / "docker-compose.yml").read_text())
    assert (
        f"./deploy/observability/{name}:/etc/prometheus/{name}:ro"
        in compose["services"]["prometheus"]["volumes"]
    )


def test_panels_do_not_lie_on_each_other() -> None:
    taken: dict[tuple[int, int], str] = {}
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24
        for x in range(place["x"], place["x"] + place["w"]):
            for y in range(place["y"], place["y"] + place["h"]):
                assert taken.setdefault((x, y), panel["title"]) == panel["title"]
