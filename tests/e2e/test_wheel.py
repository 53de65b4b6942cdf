"""The wheel alone is enough for the demo: no repository, no Node, no `.env`."""

import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import httpx
import pytest

from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(900)]

MAX_INSTALLED_MB = 250


def run(*words: str | Path, cwd: Path = REPOSITORY, env: dict[str, str] | None = None) -> str:
    """Run a command to its end and return its output; fail with the output if it fails."""
    done = subprocess.run(
        list(map(str, words)),
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=600,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, f"{done.args}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this work tree."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the locked dependencies of the demo and the wheel."""
    folder = tmp_path_factory.mktemp("environment") / "venv"
    run(sys.executable, "-m", "uv", "venv", "--quiet", "--python", sys.executable, folder)
    install = (sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", folder / "bin" / "python")
    run(*install, "--require-hashes", "-r", REPOSITORY / "requirements" / "run.lock")
    run(*install, "--no-deps", wheel)
    return folder


def test_wheel_contains_page_processes_and_licences(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for needed in (
        "handover_web/page/index.html",
        "handover_processes/processes/bin_picking.bpmn",
        "handover_robots/robots/ur10/bin_picking.yaml",
        "handover_robots/robots/ur10/ur10.urdf",
        "handover_datamodels/contexts/handover.jsonld",
        "handover_ros/mappings/arm.yaml",
        "handover_ros/messages/handover_human_msgs/msg/HeartRate.msg",
    ):
        assert needed in names
    licences = {Path(name).name for name in names if ".dist-info/licenses/" in name}
    assert licences == {"LICENSE", "NOTICE", "THIRD_PARTY.md"}
    packages = {name.partition("/")[0] for name in names if name.endswith(".py")}
    assert all(name.startswith("handover") or name == "glove_sdk_bridge" for name in packages), packages
    assert not any("/node_modules/" in name or "/app/src/" in name for name in names)


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
