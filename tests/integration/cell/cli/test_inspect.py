"""`handover broker inspect`: the content of the write-ahead log of a broker that was killed."""

import json
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.kit.cell import Cell

pytestmark = pytest.mark.slow


def inspect(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "handover_cell", "broker", "inspect", "--data-dir", str(folder), *options],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def lamp(number: int) -> dict[str, object]:
    return {
        "id": f"urn:ngsi-ld:Lamp:{number}",
        "type": "Lamp",
        "state": {"type": "Property", "value": number},
    }


def create(cell: Cell) -> None:
    """Create three Lamps in one change, which the log keeps, since no other change overwrites it."""
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/create"
    assert httpx.post(url, json=[lamp(1), lamp(2), lamp(3)], timeout=120).status_code == 201


@pytest.mark.nightly
def test_the_changes_of_a_killed_broker_are_listed_and_printed(cell: Cell) -> None:
    cell.start("context_broker")
    create(cell)
    cell.kill("context_broker")
    listed = inspect(cell.data_dir)
    assert listed.returncode == 0, listed.stderr
    assert "the tables have everything up to change" in listed.stdout
    assert "3 entity/1, 3 history/1" in listed.stdout
    printed = [json.loads(line) for line in inspect(cell.data_dir, "--json").stdout.splitlines()]
    numbers = [record["number"] for record in printed]
    assert numbers == sorted(numbers)
    entities = [record for record in printed[-1]["records"] if record["type"] == "entity/1"]
    assert [entity["id"] for entity in entities] == [lamp(number)["id"] for number in (1, 2, 3)]
    before = [path.read_bytes() for path in sorted(cell.data_dir.glob("broker.*"))]
    inspect(cell.data_dir)
    assert [path.read_bytes() for path in sorted(cell.data_dir.glob("broker.*"))] == before
    cell.start("context_broker")
    found = httpx.get(f"{cell.url('context_broker')}/ngsi-ld/v1/entities?type=Lamp", timeout=120).json()
    assert len(found) == 3, "inspecting changes nothing"


@pytest.mark.nightly
def test_a_damaged_change_is_listed(cell: Cell) -> None:
    cell.start("context_broker")
    create(cell)
    cell.kill("context_broker")
    log = cell.data_dir / "broker.log-1"
    content = bytearray(log.read_bytes())
    content[content.index(b"urn:ngsi-ld:Lamp:1")] ^= 1
    log.write_bytes(content)
    listed = inspect(cell.data_dir)
    assert listed.returncode == 0, listed.stderr
    assert "damaged: some sectors are neither old nor new" in listed.stdout
    assert "3 entity/1" not in listed.stdout


def test_without_a_log_the_way_out_is_named(tmp_path: Path) -> None:
    listed = inspect(tmp_path)
    assert listed.returncode == 2
    assert "there is no log to inspect" in listed.stderr
    assert "--data-dir" in listed.stderr
