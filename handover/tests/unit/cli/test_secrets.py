"""Secrets are random files, made once; services read them, and `handover settings` says from where."""

import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glove_sdk_bridge.command_line import parse
from handover.command_line.main import app
from handover.command_line.secrets import RECORDING_KEY, SECRETS, write_once
from handover.command_line.waiting import wait_for_secrets
from handover.errors import UsageError
from handover.settings import Settings, origins
from handover_body.settings import HumanStateSettings
from handover_gloves.command_line.glove import bridge_arguments
from handover_gloves.settings import ControllerSettings

Run = Callable[..., str]
TOKEN = "HANDOVER_GLOVE_TOKEN"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_SECRETS_DIR", str(tmp_path / "secrets"))
    return tmp_path / "secrets"


@pytest.fixture
def run() -> Run:
    def words(*given: str) -> str:
        result = CliRunner().invoke(app, ["secrets", *given], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    return words


def test_secrets_are_made_once_and_only_the_owner_can_read_them(folder: Path, run: Run) -> None:
    said = run("make")
    made = {name: (folder / name).read_text().strip() for name in SECRETS}
    assert len(set(made.values())) == len(SECRETS)
    for name, value in made.items():
        assert len(value) == (44 if name == RECORDING_KEY else 64)
        assert value not in said, "the log must not hold it"
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert "exists in" in run("make")
    assert {name: (folder / name).read_text().strip() for name in SECRETS} == made
    assert run("show").splitlines() == [f"{name}={value}" for name, value in made.items()]
    assert sorted(file.name for file in folder.iterdir()) == sorted(SECRETS), "nothing is left over"


def test_a_service_reads_a_secret_from_its_file(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN, "")  # as compose sets it where nothing is chosen
    run("make")
    assert ControllerSettings.load().token == (folder / TOKEN).read_text().strip()
    seen = {setting.name: setting for setting in origins([ControllerSettings])}
    assert (seen[TOKEN].origin, seen[TOKEN].value) == ("secret file", "********")
    asked = parse(bridge_arguments(["simulate"]), "handover glove")
    assert asked.token == (folder / TOKEN).read_text().strip(), "the simulated operator is let in with it"
    monkeypatch.setenv(TOKEN, "chosen")
    assert ControllerSettings.load().token == "chosen"
    seen = {setting.name: setting for setting in origins([ControllerSettings])}
    assert seen[TOKEN].origin == "environment"


def test_what_a_person_chose_becomes_the_secret(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANDOVER_DATABASE_PASSWORD", "p@ss/word")
    run("make")
    monkeypatch.delenv("HANDOVER_DATABASE_PASSWORD")
    assert (folder / "HANDOVER_DATABASE_PASSWORD").read_text().strip() == "p@ss/word"
    settings = Settings.load(database_url="postgresql://handover@postgres/handover")
    assert settings.database("x") == "postgresql://handover:p%40ss%2Fword@postgres/handover"
    for url in ("postgresql://handover:own@postgres/handover", "postgresql:///handover", "sqlite:///x.db"):
        assert settings.with_password(url) == url


def test_a_secret_that_cannot_be_read_is_named_with_the_way_out(folder: Path) -> None:
    (folder / TOKEN).mkdir(parents=True)
    with pytest.raises(UsageError, match=rf"{TOKEN} cannot be read: .*; make it a text file"):
        ControllerSettings.load()


def test_without_a_directory_the_setting_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HANDOVER_SECRETS_DIR", raising=False)
    with pytest.raises(UsageError, match="HANDOVER_SECRETS_DIR is not set"):
        CliRunner().invoke(app, ["secrets", "make"], catch_exceptions=False)


def test_of_many_who_make_a_secret_at_once_one_does(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "secret"
    with ThreadPoolExecutor(8) as threads:
        written = list(threads.map(lambda n: write_once(file, f"secret {n}"), range(40)))
    assert written.count(True) == 1
    assert file.read_text().strip() == f"secret {written.index(True)}"
    assert [each.name for each in file.parent.iterdir()] == ["secret"]


def test_a_service_waits_until_the_secrets_are_made(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = HumanStateSettings.model_fields
    for name in ("HANDOVER_DATABASE_PASSWORD", RECORDING_KEY, TOKEN):
        monkeypatch.setenv(name, "")
    with ThreadPoolExecutor(1) as thread:
        waiting = thread.submit(wait_for_secrets, needed, timeout_s=60)
        for name in ("HANDOVER_DATABASE_PASSWORD", RECORDING_KEY):
            assert not waiting.done()
            write_once(folder / name, "x")
        waiting.result(60)
    assert not (folder / TOKEN).exists(), "it does not need the token of gloves"
    with pytest.raises(UsageError, match=rf"no secret .*{TOKEN}; make it with: handover secrets make"):
        wait_for_secrets(("glove_token",), timeout_s=0)
    monkeypatch.delenv(TOKEN)
    wait_for_secrets(("glove_token",), timeout_s=0)  # a container that is not given it
    monkeypatch.setenv(TOKEN, "chosen")
    wait_for_secrets(("glove_token",), timeout_s=0)
    monkeypatch.delenv("HANDOVER_SECRETS_DIR")
    monkeypatch.setenv(TOKEN, "")
    wait_for_secrets(("glove_token",), timeout_s=0)
