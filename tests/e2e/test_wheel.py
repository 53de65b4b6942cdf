"""The wheels alone are enough for the demo: no repository, no Node, no `.env`."""

import re
import signal
import subprocess
import zipfile
from pathlib import Path

import httpx
import psutil
import pytest

from requirements.subset import members
from tests.kit.cell import Cell
from tests.kit.wheels import install, run, wheel_of

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(900)]

MAX_INSTALLED_MB = 200


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the wheels are built."""
    return tmp_path_factory.mktemp("wheels")


@pytest.fixture(scope="module")
def environment(place: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the wheels of the demo and their locked dependencies."""
    folder = tmp_path_factory.mktemp("environment") / "venv"
    install(["handover-cell"], folder, place)
    return folder


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        ("handover-web", "handover_web/page/index.html"),
        ("handover-processes", "handover_processes/processes/bin_picking.bpmn"),
        ("handover-robots", "handover_robots/robots/ur10/bin_picking.yaml"),
        ("handover-robots", "handover_robots/robots/ur10/ur10.urdf"),
        ("handover-datamodels", "handover_datamodels/contexts/handover.jsonld"),
        ("handover-ros", "handover_ros/mappings/arm.yaml"),
        ("handover-ros", "handover_ros/messages/handover_human_msgs/msg/HeartRate.msg"),
        ("handover-kit", "handover_renamed_modules.pth"),
        ("handover-glove-sdk-bridge", "glove_sdk_bridge/__main__.py"),
    ],
)
def test_a_wheel_contains_what_it_needs_at_run_time(name: str, needed: str, place: Path) -> None:
    assert needed in zipfile.ZipFile(wheel_of(name, place)).namelist()


@pytest.mark.parametrize("name", members())
def test_a_wheel_contains_one_package_and_its_licence(name: str, place: Path) -> None:
    names = zipfile.ZipFile(wheel_of(name, place)).namelist()
    licences = {Path(path).name for path in names if ".dist-info/licenses/" in path}
    assert licences == ({"LICENSE", "NOTICE", "THIRD_PARTY.md"} if name == "handover-cell" else {"LICENSE"})
    packages = {path.partition("/")[0] for path in names if path.endswith(".py")}
    assert len(packages) == 1
    assert packages.pop().startswith(("handover", "glove_sdk_bridge"))
    assert not any("/node_modules/" in path or "/app/src/" in path or "/tests/" in path for path in names)


def test_old_names_of_packages_work(environment: Path, tmp_path: Path) -> None:
    code = "from datamodels import Task; from services.trajectory_tool.robots import ROBOTS"
    run(environment / "bin" / "python", "-c", code, cwd=tmp_path)


def test_demo_completes_in_an_empty_folder(environment: Path, cell: Cell, tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    variables = cell.environment
    del variables["HANDOVER_DATA_DIR"]
    variables.pop("PYTHONPATH", None)
    story = run(environment / "bin" / "handover", "demo", "--once", cwd=folder, env=variables)
    assert "process   completed" in story
    assert [path.name for path in folder.iterdir()] == [".handover"]


def test_page_is_served_from_the_wheel(environment: Path, cell: Cell) -> None:
    program = [environment / "bin" / "handover", "up"]
    with subprocess.Popen(
        program, cwd=cell.data_dir, env=cell.environment, stdout=subprocess.PIPE, text=True
    ) as up:
        try:
            assert up.stdout is not None
            assert any(line.startswith("ready") for line in up.stdout)
            children = [
                " ".join(child.cmdline()) for child in psutil.Process(up.pid).children(recursive=True)
            ]
            assert any("fork_server" in words for words in children), "services are not forked"
            page = httpx.get(f"{cell.url('webui')}/work", timeout=120)
            assert page.status_code == 200
            script = re.search(r'src="(/assets/[^"]+\.js)"', page.text)
            assert script is not None
            assert httpx.get(f"{cell.url('webui')}{script[1]}", timeout=120).status_code == 200
        finally:
            up.send_signal(signal.SIGINT)


def test_environment_of_the_demo_is_small(environment: Path) -> None:
    sizes = (
        path.stat().st_size for path in environment.rglob("*") if path.is_file() and not path.is_symlink()
    )
    assert sum(sizes) < MAX_INSTALLED_MB * 10**6
