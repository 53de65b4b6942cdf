"""The doctor says which ports outgoing connections may get, and how to reserve them."""

from pathlib import Path

import pytest

from handover import ports
from handover.cli import services
from handover.cli.doctor import examine
from handover.settings import Settings


def finding(tmp_path: Path) -> tuple[bool, str]:
    (found,) = [one for one in examine(Settings.load(data_dir=tmp_path)) if one.about == "ports"]
    assert not found.needed
    return found.ok, found.words


def test_ports_that_are_not_reserved_are_named_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "_SYSCTL", tmp_path)
    monkeypatch.setattr(services, "HUMAN_STATE_NEEDS", ("a_package_that_is_not_there",))
    (tmp_path / "ip_local_port_range").write_text("32768\t60999\n")
    (tmp_path / "ip_local_reserved_ports").write_text("40000-40001\n")
    ok, words = finding(tmp_path)
    assert not ok
    listed = "40000,40001,54000,54010,54200,54210,54220,54230,54240,54270,54280,54400"
    assert f"net.ipv4.ip_local_reserved_ports={listed} " in words
    assert "1026" not in words
    (tmp_path / "ip_local_reserved_ports").write_text("40000-40001,54000-54400\n")
    assert finding(tmp_path) == (True, "no outgoing connection can get one of ours")
