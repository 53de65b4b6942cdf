"""The launcher looks before it starts anything, and lets the broker notify services on this machine."""

import asyncio
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from handover.errors import UsageError
from handover.extensions import Service
from handover.services import own_services
from handover.settings import Settings
from handover_broker.settings import BrokerSettings
from handover_cell.launching.launcher import Launcher, require_space


class Usage(NamedTuple):
    total: int
    used: int
    free: int


def test_a_full_disk_is_said_in_one_line_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 2**20))
    with pytest.raises(UsageError, match=r"is full \(1 MB left, 50 MB needed\).*--data-dir") as full:
        require_space(tmp_path)
    assert "\n" not in str(full.value)


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file/data cannot be used.*--data-dir"):
        require_space(tmp_path / "file" / "data")


def test_a_new_directory_is_made_and_left_clean(tmp_path: Path) -> None:
    require_space(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []


@pytest.mark.parametrize("own", [None, "10.0.0.0/8,scada.example"])
def test_the_broker_may_connect_to_the_services_and_to_what_is_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own: str | None
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HANDOVER_OUTBOUND_ALLOW", raising=False)
    if own is not None:
        (tmp_path / ".env").write_text(f"HANDOVER_OUTBOUND_ALLOW={own}\n")
    allowed = asyncio.run(allowed_by_the_launcher(tmp_path, own_services()))
    policy = BrokerSettings.load(host="0.0.0.0", outbound_allow=allowed).outbound_policy()
    assert policy.fault_of("127.0.0.1", 54200) is None
    assert policy.fault_of("127.0.0.1", 9) is not None, "another program of this machine"
    assert (policy.fault_of("10.1.2.3") is None, "scada.example" in policy.hosts) == (bool(own), bool(own))


def test_only_the_broker_may_connect_to_the_services(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_OUTBOUND_ALLOW", "mes.example")
    assert asyncio.run(allowed_by_the_launcher(tmp_path, [], "task-orchestrator")) == "mes.example"


async def allowed_by_the_launcher(
    data_dir: Path, services: Sequence[Service], name: str = "context-broker"
) -> str:
    """What the process `name` of the launcher finds in HANDOVER_OUTBOUND_ALLOW."""
    script = "import os; print(os.environ.get('HANDOVER_OUTBOUND_ALLOW'))"
    launcher = Launcher(services, Settings.load(data_dir=data_dir), lambda _: None)
    await launcher.add(name, [sys.executable, "-c", script])
    log = data_dir / "logs" / f"{name}.log"
    async with asyncio.timeout(120):
        while not (said := log.read_text().strip()):
            await asyncio.sleep(0.01)
    await launcher.stop()
    return said


@pytest.mark.parametrize("host", ["192.168.7.5", "fd00::7:5", "cell-3.factory.example"])
def test_the_broker_may_notify_services_that_listen_on_an_address_of_the_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, host: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_HOST", host)
    monkeypatch.setenv("HANDOVER_ORCHESTRATOR_URL", "http://10.0.0.3:54200")
    allowed = asyncio.run(allowed_by_the_launcher(tmp_path, own_services()))
    policy = BrokerSettings.load(outbound_allow=allowed).outbound_policy()
    assert policy.listens_beyond_loopback
    assert host in policy.hosts or policy.fault_of(host) is None
    assert policy.fault_of("10.0.0.3") is None
    assert policy.fault_of("10.0.0.4") is not None
