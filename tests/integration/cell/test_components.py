"""A component of others works with the one file that `handover component add` makes."""

import re
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.network.tls_trust import client_context
from handover.security.permissions import Grant, Role
from handover.transport_security.local_authority import ServerFiles
from handover_accounts.set_up import opened_store, set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage import grants, users
from tests.integration.cell.test_performer import HERE, LAMP, a_task
from tests.kit import processes
from tests.kit.cell import Cell, new_cell
from tests.kit.certificates import wait_ready_over_tls
from tests.kit.ports import next_free_port
from tests.kit.private_network import CENTRE, REMOTE, other_machine
from tests.kit.processes import clean_environment
from tests.kit.waiting import scaled, wait_for

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
        [sys.executable, "-m", "handover_cell", *words],
        env=cell.environment,
        cwd=cell.data_dir,
        capture_output=True,
        text=True,
        timeout=scaled(120),
        check=False,
    )


def as_orchestrator(cell: Cell, trust: ssl.SSLContext | bool = True) -> httpx.Client:
    """Return a client of the broker with the rights of the orchestrator."""
    service = (cell.data_dir / "security" / "service-tokens" / "task-orchestrator").read_text().strip()
    return httpx.Client(
        base_url=f"{cell.url('context_broker')}/ngsi-ld/v1",
        headers={
            "Authorization": f"Bearer {service}",
            "Link": f'<{cell.settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"',
        },
        timeout=60,
        verify=trust,
        trust_env=False,
    )


def lamp_subscription(broker: httpx.Client) -> dict[str, Any] | None:
    listed = broker.get("/subscriptions").raise_for_status().json()
    return next((one for one in listed if one["id"].endswith(":lamp-tasks")), None)


def notified(broker: httpx.Client) -> str | None:
    """Return when the broker has delivered a notification to the lamp; None if it has not."""
    moment: str | None = (lamp_subscription(broker) or {"notification": {}})["notification"].get(
        "lastSuccess"
    )
    return moment


def perform(broker: httpx.Client, name: str) -> None:
    """Make a Task for the lamp, and wait until it has completed it."""
    task = a_task(name, steps=1).to_normalized()
    broker.post("/entities", json=task).raise_for_status()

    def ends() -> bool:
        found = broker.get(f"/entities/{task['id']}").raise_for_status().json()
        return bool(found["status"]["value"] == "completed")

    wait_for(ends, 120, f"the lamp does not perform {name}")


@pytest.mark.nightly
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
    with as_orchestrator(cell) as broker:
        try:
            wait_for(lambda: lamp_subscription(broker), 90, "the lamp does not subscribe")
            perform(broker, "light-1")
            wait_for(lambda: notified(broker), 60, "nothing is sent to its address")
        except BaseException:
            print((tmp_path / "lamp.log").read_text())
            raise
        device = broker.get(f"/entities/{LAMP}").raise_for_status().json()
        assert device["performer"]["value"] == "lamp"


def test_a_client_that_is_no_service_is_refused_with_the_way_out(cell: Cell, tmp_path: Path) -> None:
    refused = handover(cell, "secure", "--client", f"{tmp_path}=lamp")
    assert refused.returncode == 2
    assert "handover component add NAME --device ID" in refused.stderr


@pytest.mark.nightly
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


class SecuredCell(Cell):
    """A cell that other machines reach, as `handover secure` makes it."""

    files: ServerFiles

    def url(self, service: str) -> str:
        return super().url(service).replace("http:", "https:")

    def wait_ready(self, service: str, within_s: float = 90.0) -> None:
        wait_ready_over_tls(self.url(service), self.files, lambda: self.log(service), within_s)


@pytest.mark.nightly
def test_a_component_on_another_machine_works_with_the_file_alone(tmp_path: Path) -> None:
    with ExitStack() as stack:
        machine = stack.enter_context(other_machine())
        plain = stack.enter_context(new_cell(tmp_path))
        cell = SecuredCell(tmp_path, plain.ports, processes=plain.processes)
        secured = handover(cell, "secure", "--name", CENTRE)
        assert secured.returncode == 0, secured.stderr
        cell.extra.update(re.findall(r"^ +(HANDOVER_\w+)=(\S+)$", secured.stdout, re.MULTILINE))
        cell.extra["HANDOVER_HOST"] = "0.0.0.0"
        folder = tmp_path / "tls" / "server"
        cell.files = ServerFiles(folder, (CENTRE,), datetime.now(UTC), is_new=True)
        cell.start("accounts", "context_broker", "task_orchestrator", within_s=120)

        there = tmp_path / "other machine"
        there.mkdir()
        words = ("--device", "lamp-1", "--url", f"https://{REMOTE}:9100", "--file", str(there / ".env"))
        made = handover(cell, "component", "add", "lamp", *words)
        assert made.returncode == 0, made.stderr
        assert "127.0.0.1" not in (there / ".env").read_text()
        (there / "lamp.py").write_text((HERE / "lamp.py").read_text())

        def start() -> processes.Process:
            lamp = processes.spawn(
                machine.within(sys.executable, "lamp.py"), clean_environment(), there / "lamp.log", there
            )
            stack.callback(processes.kill, lamp)
            return lamp

        lamp = start()
        stack.callback(lambda: print((there / "lamp.log").read_text()))
        with as_orchestrator(cell, client_context(cell.files.authority)) as broker:
            wait_for(lambda: lamp_subscription(broker), 120, "the lamp does not subscribe")
            perform(broker, "light-1")
            wait_for(lambda: notified(broker), 60, "the broker does not reach the lamp")
        cell.restart("context_broker")
        with as_orchestrator(cell, client_context(cell.files.authority)) as broker:
            perform(broker, "light-2")
            processes.kill(lamp)
            # Its certificate and token are replaced, as once a year.
            (there / ".env").unlink()
            made = handover(cell, "component", "add", "lamp", *words)
            assert made.returncode == 0, made.stderr
            before = notified(broker)
            lamp = start()
            perform(broker, "light-3")
            wait_for(lambda: notified(broker) != before, 60, "the broker no longer notifies the lamp")
        lamp.terminate()
        lamp.wait(scaled(60))
