"""`handover component add` makes a file with which a component starts, also on another machine."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from handover.command_line.main import app
from handover.errors import UsageError
from handover.network.tls_trust import client_context
from handover.security.service_access import has_component_token
from handover.settings import Settings
from handover.transport_security.server_certificate import ServerCertificate

Add = Callable[..., Result]


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cell that other machines reach, in the present directory; its settings are in the environment."""
    monkeypatch.chdir(tmp_path)
    made = CliRunner().invoke(app, ["secure", "--name", "cell-3.example", "--name", "192.168.1.20"])
    assert made.exit_code == 0, made.output
    for name, value in re.findall(r"^ +(HANDOVER_\w+)=(\S+)$", made.output, re.MULTILINE):
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("HANDOVER_HOST", "0.0.0.0")
    return tmp_path


@pytest.fixture
def add(cell: Path) -> Add:
    def words(*given: str) -> Result:
        file = cell / "lamp.env"
        file.unlink(missing_ok=True)
        return CliRunner().invoke(app, ["component", "add", "lamp", "--device", "lamp-1", *given])

    return words


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("words", "cell_host", "listens"),
    [
        (("--url", "https://192.168.1.31:9100"), "cell-3.example", "192.168.1.31"),
        (("--url", "https://lamp.example:9100/"), "cell-3.example", "0.0.0.0"),
        (("--url", "https://[fd00::31]:9100", "--cell", "192.168.1.20"), "192.168.1.20", "fd00::31"),
        (("--cell", "192.168.1.20"), "192.168.1.20", "127.0.0.1"),
        (("--url", "http://127.0.0.1:9100"), "127.0.0.1", "127.0.0.1"),
        (("--url", "https://localhost:9100"), "127.0.0.1", "127.0.0.1"),
        ((), "127.0.0.1", "127.0.0.1"),
    ],
)
def test_the_file_has_every_setting_of_the_component(
    add: Add, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], cell_host: str, listens: str
) -> None:
    made = add(*words)
    assert made.exit_code == 0, made.output
    other = Path.cwd() / "other"
    other.mkdir()
    Path("lamp.env").rename(other / ".env")
    for name in Settings.model_fields:
        monkeypatch.delenv(f"HANDOVER_{name}".upper(), raising=False)
    monkeypatch.chdir(other)

    settings = Settings.load()
    assert settings.host == listens
    addresses = settings.broker_url, *settings.lease_urls, settings.accounts_url or ""
    assert {one.rpartition(":")[0] for one in addresses} == {f"https://{cell_host}"}
    assert has_component_token(settings)
    assert len(client_context(*settings.ca_files).get_ca_certs()) > 0
    url = dict(zip(words[::2], words[1::2], strict=True)).get("--url", "")
    assert settings.url_of(9100, settings.component_url) == (url.rstrip("/") or "http://127.0.0.1:9100")
    certificate = ServerCertificate.of(settings)
    assert (certificate is not None) == url.startswith("https")
    if certificate is not None:
        assert certificate.is_for(url.removeprefix("https://").rstrip("/").removesuffix(":9100").strip("[]"))


@pytest.mark.parametrize(
    ("words", "environment", "fault"),
    [
        (("--url", "http://192.168.1.31:9100"), {}, r"needs TLS; write it as https://"),
        (("--cell", "other.example"), {}, r"not for other\.example.*handover secure --name other\.example"),
        (("--cell", "192.168.1.20"), {"HOST": "127.0.0.1"}, r"HANDOVER_HOST is 127\.0\.0\.1.*set it to"),
        (
            ("--url", "https://192.168.1.31:9100"),
            {"TLS_CERTIFICATE": "", "TLS_KEY": "", "BROKER_URL": "https://127.0.0.1:1026"},
            r"name this machine as they do: --cell HOST",
        ),
        (
            ("--url", "https://192.168.1.31:9100"),
            {"AUTHORITY_DIR": "elsewhere"},
            r"no authority in elsewhere.*handover secure",
        ),
        (("--url", "https://la'mp:9100"), {}, r"is no address"),
        (("--url", "https://la_mp!:9100"), {}, r"neither a host name nor an address"),
        (("--url", "ftp://192.168.1.31"), {}, r"is no address; write http://HOST:PORT"),
    ],
)
def test_a_component_that_could_not_work_is_refused_and_nothing_is_made(
    add: Add, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], environment: dict[str, str], fault: str
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(f"HANDOVER_{name}", value)
    refused = add(*words).exception
    assert isinstance(refused, UsageError)
    assert re.search(fault, str(refused)), refused
    assert not Path("lamp.env").exists()
    assert not Path(".handover/security/components").exists()
