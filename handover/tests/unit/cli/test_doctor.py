"""The doctor says what is wrong with the machine, and the way out."""

import os
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from handover.extensions import load_service
from handover.runtime import ports
from handover.settings import Settings
from handover_cell.doctor import examine


def finding(tmp_path: Path) -> tuple[bool, str]:
    (found,) = [one for one in examine(Settings.load(data_dir=tmp_path)) if one.about == "ports"]
    assert not found.needed
    return found.ok, found.words


def test_ports_that_are_not_reserved_are_named_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "_SYSCTL", tmp_path)
    body = replace(load_service("human-state"), needs=("no_such_package",))
    monkeypatch.setattr("handover_body.settings.SERVICE", body)
    (tmp_path / "ip_local_port_range").write_text("32768\t60999\n")
    (tmp_path / "ip_local_reserved_ports").write_text("40000-40001\n")
    ok, words = finding(tmp_path)
    assert not ok
    listed = "40000,40001,54000,54010,54200,54210,54220,54230,54240,54270,54280,54400"
    assert f"net.ipv4.ip_local_reserved_ports={listed} " in words
    assert "1026" not in words
    (tmp_path / "ip_local_reserved_ports").write_text("40000-40001,54000-54400\n")
    assert finding(tmp_path) == (True, "no outgoing connection can get one of ours")


def examined(tmp_path: Path, about: str) -> list[tuple[bool, bool, str]]:
    return [
        (one.ok, one.needed, one.words)
        for one in examine(Settings.load(data_dir=tmp_path))
        if one.about == about
    ]


@pytest.mark.nightly
def test_the_port_of_another_program_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        monkeypatch.setenv("HANDOVER_STUDY_PORT", str(port))
        monkeypatch.setenv("HANDOVER_STUDY_URL", "http://127.0.0.1:1")  # nothing answers there
        ((ok, needed, words),) = examined(tmp_path, "study")
    assert not ok
    assert needed
    assert str(port) in words


@pytest.mark.nightly
def test_a_client_of_docker_without_its_engine_is_not_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "docker"
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    for script, is_well in (
        ("echo Cannot connect to the Docker daemon >&2; exit 1", False),
        ("echo; exit 0", False),
        ("echo 27.1", True),
    ):
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        ((ok, needed, words),) = examined(tmp_path, "docker")
        assert (ok, needed) == (is_well, False), words
        assert is_well or "its engine does not answer" in words


@pytest.mark.nightly
def test_a_folder_that_is_missing_is_not_made(tmp_path: Path) -> None:
    ((ok, _, words),) = examined(tmp_path / "new" / "data", "data directory")
    assert ok
    assert "does not exist; the first service makes it" in words
    assert not (tmp_path / "new").exists()
    (tmp_path / "file").touch()
    ((ok, needed, words),) = examined(tmp_path / "file" / "data", "data directory")
    assert not ok
    assert needed
