"""Old names of packages work with one warning, and never in place of a package of the user."""

import subprocess
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

import pytest

from handover.renamed_modules import MOVED, RENAMED
from handover.settings import Settings
from tests.kit.paths import REPOSITORY


def run(code: str, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, which imports from `folder` first."""
    return subprocess.run(
        [sys.executable, *flags, "-c", code], cwd=folder, capture_output=True, text=True, timeout=120
    )


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@pytest.mark.parametrize("package", RENAMED)
def test_every_new_name_exists(package: str) -> None:
    assert find_spec(RENAMED[package]) is not None


@pytest.mark.parametrize("inside", [False, True], ids=["elsewhere", "in a checkout"])
def test_an_old_name_is_the_same_module_and_warns_once(inside: bool, tmp_path: Path) -> None:
    done = run(
        "from datamodels import Task\n"
        "from datamodels.states import TaskStatus\n"
        "from services.trajectory_tool.poses import pointing_down\n"
        "import services.trajectory_tool.poses\n"
        "import ros_fiware_bridge.errors, webui.metrics\n"
        "from handover.cli import services as of_cell\n"
        "import handover_robots.poses\n"
        "import handover.services, handover_datamodels\n"
        "import handover_robots.model.poses, handover_ros.errors\n"
        "assert Task is handover_datamodels.Task\n"
        "assert pointing_down is handover_robots.model.poses.pointing_down\n"
        "assert services.trajectory_tool.poses is handover_robots.model.poses\n"
        "assert handover_robots.poses is handover_robots.model.poses\n"
        "assert ros_fiware_bridge.errors is handover_ros.errors\n"
        "assert of_cell is handover.services\n"
        "assert handover_robots.poses.__spec__.name == 'handover_robots.model.poses'\n",
        REPOSITORY if inside else tmp_path,
        "-W",
        "always::DeprecationWarning",
    )
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if "DeprecationWarning" in line]
    assert warnings[0].startswith("<string>:1: DeprecationWarning: datamodels is now handover_datamodels;")
    assert [line.split()[2] for line in warnings] == [
        "datamodels",
        "services.trajectory_tool",
        "services.trajectory_tool.poses",
        "ros_fiware_bridge",
        "webui",
        "handover.cli",
        "handover_cell.services",
        "handover_robots.poses",
    ]


def test_modules_that_have_moved_are_found_by_their_old_names(tmp_path: Path) -> None:
    done = run(
        "from importlib import import_module\n"
        "from handover.renamed_modules import MOVED\n"
        "for old, new in MOVED.items():\n"
        "    assert import_module(old) is import_module(new), old\n",
        tmp_path,
        "-W",
        "always::DeprecationWarning",
    )
    assert done.returncode == 0, done.stderr
    warnings = {line.partition("Warning: ")[2] for line in done.stderr.splitlines() if "Deprecation" in line}
    texts = {
        f"{old} is now {new}; import that, the old name works until Handover 1.0"
        for old, new in MOVED.items()
    }
    assert texts <= warnings


def test_the_interface_of_drivers_is_complete_by_its_old_names(tmp_path: Path) -> None:
    done = run(
        "from handover_robots.cyclic_robot import CyclicRobot\n"
        "from handover_robots.cycles import Cycles\n"
        "from handover_robots.drivers import DRIVERS, Clock, Peer, RobotContext, RobotFactory\n"
        "from handover_robots.robot import Joints, JointState, Pace, Robot, Velocity\n"
        "from handover_robots.robot import SafetyStatus, StopCategory, TruePart\n"
        "from handover_robots.robot import LeaseEnded, NoPath, RobotFault, UnknownOutcome, Unreachable\n"
        "from handover_robots.robot_model import AllSolutions, Finger, InverseKinematics, RobotModel\n"
        "from handover_robots.robot_model import load_srdf, read_model\n"
        "from handover_robots.scene import Scene, load\n"
        "from handover_robots.trajectory import Course, Limits, Setpoint\n",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr


def test_a_folder_with_compiled_files_of_an_earlier_checkout_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "earlier" / "notation" / "__pycache__").mkdir(parents=True)
    done = run(
        "import handover_processes\n"
        "handover_processes.__path__.append('earlier')\n"
        "from handover_processes.notation.file import read_bpmn\n"
        "import handover_bpmn.notation.file\n"
        "assert read_bpmn is handover_bpmn.notation.file.read_bpmn\n",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr


def test_an_old_module_runs_as_a_program(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "handover.cli", "--version"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout.split()[0]) == (0, "handover"), done.stderr


@pytest.mark.parametrize(
    "name",
    [
        "datamodels.Nothing",
        "handover_broker.federation.nothing",
        "handover_robots.nothing",
        "services.nothing",
        "services.study.nothing",
        "webui.nothing",
    ],
)
def test_what_never_existed_is_not_found(name: str, tmp_path: Path) -> None:
    done = run(f"import {name}", tmp_path)
    assert "ModuleNotFoundError: No module named" in done.stderr


def test_packages_of_the_user_are_preferred(tmp_path: Path) -> None:
    write(
        tmp_path,
        {
            "services/__init__.py": "",
            "services/study.py": "NAME = 'mine'",
            "webui.py": "NAME = 'mine'",
            "datamodels/entities.py": "NAME = 'mine'",
        },
    )
    done = run(
        "import datamodels.entities, services.study, webui\n"
        "assert datamodels.entities.NAME == services.study.NAME == webui.NAME == 'mine'\n"
        "import services.accounts",
        tmp_path,
        "-W",
        "error",
    )
    assert done.stderr.splitlines()[-1] == "ModuleNotFoundError: No module named 'services.accounts'"


def test_a_folder_of_the_user_without_a_package_hides_nothing(tmp_path: Path) -> None:
    write(tmp_path, {"services/compose.yaml": "", "services/mine.py": ""})
    done = run("import services.mine\nfrom services.study.settings import StudySettings", tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_start_without_old_names_imports_nothing(tmp_path: Path) -> None:
    code = "import sys; print([name for name in sys.modules if name.startswith('handover')])"
    assert run(code, tmp_path).stdout == "[]\n"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("services/study/wording/de.json", "services/study/handover_study/wording/de.json"),
        ("services/trajectory_tool/robots/x.yaml", "services/trajectory_tool/handover_robots/robots/x.yaml"),
        ("webui/page/index.html", "webui/handover_web/page/index.html"),
        ("handover/cli/main.py", "handover/handover_cell/main.py"),
    ],
)
def test_a_setting_with_the_old_path_of_a_shipped_file_finds_it(tmp_path: Path, old: str, new: str) -> None:
    file = tmp_path / new
    file.parent.mkdir(parents=True)
    file.touch()
    for given in (tmp_path / old, file):
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            settings = Settings(broker_token_file=given)
        assert settings.broker_token_file == file
        said = f"{given} is now {file}; set that, the old path works until Handover 1.0"
        assert [str(each.message) for each in warned] == ([] if given == file else [said])


def test_another_path_is_left_as_it_is(tmp_path: Path) -> None:
    for given in (tmp_path / "services/study/mine.json", tmp_path / "my-services/study/mine.json"):
        assert Settings(broker_token_file=given).broker_token_file == given
