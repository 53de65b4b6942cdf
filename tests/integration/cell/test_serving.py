"""Every service refuses a directory where it cannot write, and waits for a port that a connection has."""

import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from handover.extensions import Service
from handover.services import own_services
from tests.kit.cell import Cell
from tests.kit.ports import next_free_port
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow

AS_ANY_USER = ["setpriv", "--bounding-set=-dac_override"] if os.geteuid() == 0 else []
"""Root without its right to write everywhere."""


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A directory in which nobody may write."""
    tmp_path.chmod(0o555)
    yield tmp_path
    tmp_path.chmod(0o755)


def start(service: Service, data_dir: Path, **settings: str) -> "subprocess.CompletedProcess[str]":
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}
    environment |= {
        "HANDOVER_DATA_DIR": str(data_dir),
        service.port_setting: str(next_free_port()),
        "HANDOVER_GLOVE_PORT": str(next_free_port()),
        **settings,
    }
    return subprocess.run(
        [*AS_ANY_USER, sys.executable, "-m", service.module],
        env=environment,
        cwd="/",
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.nightly
@pytest.mark.parametrize("service", own_services(), ids=lambda service: service.name)
def test_a_service_refuses_a_data_directory_in_which_it_cannot_write(
    service: Service, read_only: Path
) -> None:
    ended = start(service, read_only, HANDOVER_ROS_MAPPING="arm")
    (line,) = ended.stderr.strip().splitlines()
    assert ended.returncode == 2
    assert f"the data directory {read_only} cannot be written by user" in line
    assert "set HANDOVER_DATA_DIR to another directory" in line
    assert list(read_only.iterdir()) == []


def test_a_service_waits_for_a_connection_that_has_its_port_and_then_starts(cell: Cell) -> None:
    port = cell.ports["context_broker"]
    with socket.create_server(("127.0.0.1", 0)) as server:
        outgoing = socket.socket()
        outgoing.bind(("127.0.0.1", port))  # as the system binds those of any program
        outgoing.connect(server.getsockname())
        incoming, _ = server.accept()
        log = cell.data_dir / "context_broker.log"
        with outgoing, incoming, log.open("wb") as written:
            cell.processes["context_broker"] = broker = subprocess.Popen(
                [sys.executable, "-m", "handover_broker"],
                env=cell.environment,
                stdin=subprocess.DEVNULL,
                stdout=written,
                stderr=written,
            )
            said = f"port {port} is held by a connection to 127.0.0.1:{server.getsockname()[1]}"
            wait_for(lambda: said in log.read_text(), 60, log.read_text)
            assert broker.poll() is None
            outgoing.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        cell.wait_ready("context_broker", 60)


@pytest.mark.skipif(os.name != "posix", reason="files have no modes on this system")
def test_a_start_takes_the_permissions_of_others_with_one_log_line(cell: Cell) -> None:
    cell.start("context_broker")
    cell.kill("context_broker")
    cell.data_dir.chmod(0o755)
    for file in cell.data_dir.glob("broker.*"):
        file.chmod(0o644)
    earlier = cell.log("context_broker").count("others could read")
    cell.start("context_broker")
    assert cell.log("context_broker").count("others could read") == earlier + 1
    assert cell.data_dir.stat().st_mode & 0o777 == 0o700
    stored = list(cell.data_dir.glob("broker.*"))
    assert stored
    assert [file for file in stored if file.stat().st_mode & 0o077] == []
