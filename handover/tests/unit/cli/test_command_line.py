"""What all commands have in common: help, lists for programs, version, and the way out where TLS answers."""

import json
import socket
import ssl
import threading
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

import pytest
from typer.testing import CliRunner

from handover.command_line.access import ask_service
from handover.command_line.commands import commands_of
from handover.command_line.main import app
from handover.errors import UsageError
from handover.settings import Settings
from tests.kit.certificates import Certificates

OTHER_OPTIONS = {("glove",)}
"""Commands of another parser."""


def test_each_command_has_a_short_option_for_its_help() -> None:
    for words, _ in commands_of(app):
        if words not in OTHER_OPTIONS:
            shown = CliRunner().invoke(app, [*words, "-h"])
            assert shown.exit_code == 0, (words, shown.output)
            assert "Usage" in shown.output


def test_each_list_is_there_for_programs_too() -> None:
    lists = {
        words: {name for parameter in command.params for name in parameter.opts}
        for words, command in commands_of(app)
        if words and (words[-1] == "list" or (command.help or "").startswith(("List ", "Print every ")))
    }
    assert len(lists) >= 10
    assert [words for words, options in lists.items() if "--json" not in options] == []


def test_lists_for_programs_are_one_document(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDOVER_DATA_DIR", "")  # commands change it for the services that they start
    for words in (["robot", "list"], ["settings"], ["case"], ["doctor", "--data-dir", str(tmp_path)]):
        listed = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
        assert listed
        assert all(isinstance(each, dict) for each in listed)


def test_the_version_is_that_of_the_distribution() -> None:
    assert CliRunner().invoke(app, ["--version"]).stdout == f"handover {version('handover-cell')}\n"


def test_without_a_command_it_says_what_to_do_next() -> None:
    shown = CliRunner().invoke(app, [])
    assert shown.exit_code == 0
    commands = [line.split()[1] for line in shown.stdout.splitlines() if line.startswith("  handover ")]
    assert commands == ["demo", "up", "doctor"]
    for command in commands:
        assert CliRunner().invoke(app, [command, "--help"]).exit_code == 0


def test_shells_can_complete_commands() -> None:
    assert "--install-completion" in CliRunner().invoke(app, ["--help"]).stdout


def test_where_tls_answers_nobody_is_asked_to_start_it(tmp_path: Path) -> None:
    files = Certificates(tmp_path).make("127.0.0.1")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(files.certificate, files.key)
    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=_serve_tls, args=(server, context), daemon=True).start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(UsageError, match="speaks TLS, and the settings here have no certificate"):
            ask_service("device gateway", Settings.load(data_dir=tmp_path), "GET", url, "/devices")
    with pytest.raises(UsageError, match=r"does not answer at .*; start it with: handover up"):
        ask_service("device gateway", Settings.load(data_dir=tmp_path), "GET", url, "/devices")


def _serve_tls(server: socket.socket, context: ssl.SSLContext) -> None:
    while True:
        try:
            connection, _ = server.accept()
        except OSError:
            return
        with closing(connection):
            try:
                context.wrap_socket(connection, server_side=True).close()
            except OSError:
                continue
