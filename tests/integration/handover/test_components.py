"""A component of others works with the one file that `handover component add` makes."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.security.permissions import Grant, Role
from services.accounts import grants, users
from services.accounts.set_up import opened_store, set_up
from services.accounts.settings import AccountsSettings
from tests.integration.handover.test_performer import HERE, LAMP, a_task
from tests.kit.cell import Cell, new_cell
from tests.kit.ports import next_free_port
from tests.kit.processes import clean_environment
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell with accounts."""
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        settings = AccountsSettings.load(data_dir=made.data_dir)
        set_up(settings, ("context-broker", "task-orchestrator", "cli"))
        with opened_store(settings) as store, store.change("test", "test") as change:
            grants.add_grant(change, users.add_user(change, "Olga", None), Grant(Role.ADMIN))
        made.start("accounts", "context_broker", "task_orchestrator", within_s=90)
        yield made


def handover(cell: Cell, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "handover.cli", *words],
        env=cell.environment,
        cwd=cell.data_dir,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_lamp_of_the_tutorial_performs_with_the_file_alone(cell: Cell, tmp_path: Path) -> None:
    cell.ports["lamp"] = port = next_free_port()
    made = handover(
        cell,
        *("component", "add", "lamp", "--device", "lamp-1", "--url", f"http://127.0.0.1:{port}"),
        *("--file", str(tmp_path / ".env")),
    )
    assert made.returncode == 0, made.stderr
    assert (tmp_path / ".env").stat().st_mode & 0o777 == 0o600
    (tmp_path / "lamp.py").write_text((HERE / "lamp.py").read_text().replace("9100", str(port)))
    with (tmp_path / "lamp.log").open("wb") as log:
        cell.processes["lamp"] = subprocess.Popen(
            [sys.executable, "lamp.py"], env=clean_environment(), cwd=tmp_path, stdout=log, stderr=log
        )
    service = (cell.data_dir / "security" / "service-tokens" / "task-orchestrator").read_text().strip()
    with httpx.Client(
        base_url=f"{cell.url('context_broker')}/ngsi-ld/v1",
        headers={
            "Authorization": f"Bearer {service}",
            "Link": f'<{cell.settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"',
        },
        timeout=60,
        trust_env=False,
    ) as broker:

        def subscribed() -> dict[str, Any] | None:
            listed = broker.get("/subscriptions").raise_for_status().json()
            return next((one for one in listed if one["id"].endswith(":lamp-tasks")), None)

        try:
            wait_for(subscribed, 90, "the lamp does not subscribe")
            task = a_task("light-1", steps=1).to_normalized()
            broker.post("/entities", json=task).raise_for_status()

            def ends() -> bool:
                found = broker.get(f"/entities/{task['id']}").raise_for_status().json()
                return bool(found["status"]["value"] == "completed")

            wait_for(ends, 90, "the lamp does not perform its Task")
        except BaseException:
            print((tmp_path / "lamp.log").read_text())
            raise
        device = broker.get(f"/entities/{LAMP}").raise_for_status().json()
        assert device["performer"]["value"] == "lamp"
        sent = wait_for(lambda: (subscribed() or {})["notification"].get("timesSent"), 60, "nothing is sent")
        assert sent
        assert "lastSuccess" in (subscribed() or {})["notification"], "its address is allowed"


def test_a_client_that_is_no_service_is_refused_with_the_way_out(cell: Cell, tmp_path: Path) -> None:
    refused = handover(cell, "secure", "--client", f"{tmp_path}=lamp")
    assert refused.returncode == 2
    assert "handover component add NAME --device ID" in refused.stderr


def test_a_component_that_was_removed_has_neither_rights_nor_subscriptions(
    cell: Cell, tmp_path: Path
) -> None:
    file, address = tmp_path / "arm.env", f"http://127.0.0.1:{next_free_port()}"
    words = ("--device", "arm-1", "--url", address, "--file", str(file))
    assert handover(cell, "component", "add", "arm", *words).returncode == 0
    values = dict(line.split("=", 1) for line in file.read_text().splitlines() if "=" in line)
    headers = {"Authorization": f"Bearer {values['HANDOVER_SERVICE_TOKEN'].strip(chr(39))}"}
    base = f"{cell.url('context_broker')}/ngsi-ld/v1"
    subscription = {
        "type": "Subscription",
        "entities": [{"type": "Task"}],
        "notification": {"endpoint": {"uri": f"{address}/any"}},
    }
    with httpx.Client(base_url=base, headers=headers, timeout=60, trust_env=False) as client:
        assert client.get("/entities?local=true").status_code == 200
        assert client.post("/subscriptions", json=subscription).status_code == 201
        removed = handover(cell, "component", "remove", "arm")
        assert removed.returncode == 0, removed.stderr
        assert "1 subscriptions are deleted" in removed.stdout
        wait_for(
            lambda: client.get("/entities?local=true").status_code == 401, 60, "the token is still valid"
        )
