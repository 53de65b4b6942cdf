"""`handover secure` makes TLS and accounts in one go, for this machine or for the containers of a cell."""

import shutil
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from handover.command_line.main import app
from handover.command_line.waiting import wait_for_security
from handover.errors import UsageError
from handover.security.protection import require_protection
from handover.services import own_services
from handover.settings import Settings
from tests.kit.paths import REPOSITORY

Run = Callable[..., str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.chdir(tmp_path)

    def words(*given: str) -> str:
        result = CliRunner().invoke(app, ["secure", *given], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    return words


def files_in(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith("accounts.db")
    }


def test_one_command_makes_what_a_server_needs_beyond_loopback(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError):
        require_protection(Settings.load(), "0.0.0.0", "HANDOVER_HOST")
    said = run("--name", "cell-3.factory.example", "--name", "192.168.1.20")
    assert "https://cell-3.factory.example:54400/join#hnd_link_" in said
    for line in said.splitlines():
        name, equals, value = line.strip().partition("=")
        if equals and name.startswith("HANDOVER_"):
            monkeypatch.setenv(name, value)
    settings = Settings.load()
    require_protection(settings, "0.0.0.0", "HANDOVER_HOST")
    assert settings.allowed_hosts == ("cell-3.factory.example",)
    tokens = tmp_path / ".handover/security/service-tokens"
    named = {service.name for service in own_services()} | {"cli"}
    assert {file.name for file in tokens.iterdir()} == named
    assert {stat.S_IMODE(file.stat().st_mode) for file in tokens.iterdir()} == {0o600}


def test_without_a_name_it_is_for_this_machine(run: Run) -> None:
    said = run()
    assert "for localhost, 127.0.0.1, ::1" in said
    assert "https://127.0.0.1:54400/join#hnd_link_" in said


def test_repeated_it_changes_nothing_and_prints_another_link_until_there_is_an_owner(
    run: Run, tmp_path: Path
) -> None:
    first = run("--name", "cell-3.factory.example")
    made = files_in(tmp_path)
    second = run()
    assert files_in(tmp_path) == made
    links = [said.partition("/join#")[2].split()[0] for said in (first, second)]
    assert links[0] != links[1]
    assert "https://cell-3.factory.example:54400/join#" in second


@pytest.mark.parametrize("words", [("--server", "/tls/x"), ("--server", "=x"), ("--client", "/tls/x=,")])
def test_a_folder_without_a_name_is_refused(words: tuple[str, str], run: Run) -> None:
    with pytest.raises(UsageError, match="names no folder with a name"):
        run(*words)


def test_the_override_mounts_what_was_made_where_the_containers_look(run: Run, tmp_path: Path) -> None:
    compose = tmp_path / "docker-compose.yml"
    shutil.copy(REPOSITORY / "docker-compose.yml", compose)
    arguments = (
        "--compose",
        str(compose),
        "--name",
        "cell-3.factory.example",
        "--data-dir",
        str(tmp_path / "data"),
    )
    said = run(*arguments)
    assert "https://cell-3.factory.example:54400/join#" in said
    shipped = yaml.safe_load(compose.read_text())
    override = yaml.safe_load((tmp_path / "docker-compose.override.yml").read_text())["services"]
    made = files_in(tmp_path / "data")
    for name, service in override.items():
        targets = {mount.split(":")[1]: mount.split(":")[0] for mount in service["volumes"]}
        before = {mount.split(":")[1] for mount in shipped["services"][name]["volumes"]}
        assert set(targets) <= before
        if "/tls" in targets and name in {"other-broker", "postgres"}:
            folder = Path(targets["/tls"]).relative_to(tmp_path / "data")
            assert {file.rpartition("/")[2] for file in made if file.startswith(f"{folder}/")} >= {
                "certificate.pem",
                "key.pem",
                "authority.pem",
            }
            assert f"{folder}/service-token" not in made
        elif "/tls" in targets and name not in {"prometheus", "simulated-operator"}:
            folder = Path(targets["/tls"]).relative_to(tmp_path / "data")
            for file in ("certificate.pem", "key.pem", "authority.pem", "service-token"):
                assert f"{folder}/{file}" in made, (name, file)
            assert "public-keys.json" in {path.name for path in Path(targets["/security"]).iterdir()}
            assert service["environment"] == {"HANDOVER_ALLOWED_HOSTS": "cell-3.factory.example"}
    assert {service.name for service in own_services()} < set(override)
    web = next(word for word in override["init"]["command"] if "webui" in word)
    assert web == "--server=/tls/webui=webui,cell-3.factory.example", (
        "the next start must not make another one"
    )
    run(*arguments)
    assert files_in(tmp_path / "data") == made


def test_a_compose_file_of_others_is_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "compose.yml").write_text("services: {web: {image: nginx}}")
    with pytest.raises(UsageError, match='has no service "init"'):
        run("--compose", str(tmp_path / "compose.yml"))
    with pytest.raises(UsageError, match="cannot be read"):
        run("--compose", str(tmp_path / "missing.yml"))


def test_a_service_waits_for_its_files_and_names_the_one_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wait_for_security(timeout_s=0)
    monkeypatch.setenv("HANDOVER_SECURITY_DIR", str(tmp_path))
    with pytest.raises(UsageError, match=r"no file .*public-keys.json; make it with: handover secure"):
        wait_for_security(timeout_s=0)
    (tmp_path / "public-keys.json").write_text("{}")
    wait_for_security(timeout_s=0)
    monkeypatch.setenv("HANDOVER_TLS_KEY", str(tmp_path / "key.pem"))
    with pytest.raises(UsageError, match="HANDOVER_TLS_KEY is"):
        wait_for_security("HANDOVER_TLS_KEY", timeout_s=0)


def test_a_reader_gets_a_copy_of_the_secrets_that_it_uses_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    monkeypatch.setenv("HANDOVER_SECRETS_DIR", str(tmp_path / "secrets"))
    words = ("--secret", f"{tmp_path / 'gloves'}=HANDOVER_GLOVE_TOKEN")
    run(*words)
    copy, secret = tmp_path / "gloves" / "HANDOVER_GLOVE_TOKEN", tmp_path / "secrets" / "HANDOVER_GLOVE_TOKEN"
    assert [one.name for one in (tmp_path / "gloves").iterdir()] == ["HANDOVER_GLOVE_TOKEN"]
    assert copy.read_bytes() == secret.read_bytes()
    assert copy.stat().st_mode & 0o777 == 0o600
    secret.unlink()
    run(*words)
    assert copy.read_bytes() == secret.read_bytes(), "a secret that was replaced is replaced there"
    with pytest.raises(UsageError, match="there is no secret"):
        run("--secret", f"{tmp_path / 'gloves'}=HANDOVER_NOTHING")
