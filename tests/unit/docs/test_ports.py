"""The page about production lists every port of ours, with its default."""

import re
from pathlib import Path

import pytest

from handover.services import own_services
from tests.kit.paths import REPOSITORY

ROW = re.compile(r"^\| (\d+) \| `(HANDOVER_\w+_PORT)` \|", re.MULTILINE)


def test_every_port_is_listed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # no .env
    page = (REPOSITORY / "docs/how-to/production.md").read_text(encoding="utf-8")
    listed = {setting: int(port) for port, setting in ROW.findall(page)}
    listens = [one for service in own_services() for one in service.listens()]
    assert listed == {setting: port for _, port, setting in listens}
    assert {host for host, _, _ in listens} == {"127.0.0.1"}
