"""A server that other machines reach needs TLS and accounts; the error names what is missing."""

from pathlib import Path

import pytest

from handover.errors import Problem, UsageError
from handover.security.access_tokens import SigningKey, key_set
from handover.security.authentication import Guard
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.protection import require_protection
from handover.settings import Settings
from handover_devices.connection.device_server import DeviceServer
from handover_devices.settings import GatewaySettings
from handover_gloves.app import make_app
from handover_gloves.settings import ControllerSettings

BEYOND_LOOPBACK = ["0.0.0.0", "::", "192.168.1.4", "cell-3.example", ""]
CERTIFICATE = {"tls_certificate": "certificate.pem"}
PROXY = {"tls_proxy_url": "https://cell-3.example"}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_DATA_DIR", str(tmp_path))


@pytest.fixture
def accounts(tmp_path: Path) -> None:
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))


@pytest.mark.parametrize("host", BEYOND_LOOPBACK)
@pytest.mark.usefixtures("accounts")
def test_beyond_loopback_a_server_without_tls_is_refused(host: str) -> None:
    with pytest.raises(UsageError, match=r"HANDOVER_HOST is .* no TLS; run `handover secure`.*TLS_PROXY_URL"):
        require_protection(Settings.load(), host, "HANDOVER_HOST")
    require_protection(Settings.load(**CERTIFICATE), host, "HANDOVER_HOST")
    require_protection(Settings.load(**PROXY), host, "HANDOVER_HOST")


@pytest.mark.parametrize("host", BEYOND_LOOPBACK)
@pytest.mark.parametrize("given", [CERTIFICATE, PROXY])
def test_beyond_loopback_a_server_without_accounts_is_refused(host: str, given: dict[str, str]) -> None:
    with pytest.raises(UsageError, match=r"HANDOVER_HOST is .* no accounts; run `handover secure`"):
        require_protection(Settings.load(**given), host, "HANDOVER_HOST")
    with pytest.raises(UsageError, match="no TLS and no accounts"):
        require_protection(Settings.load(), host, "HANDOVER_HOST")


@pytest.mark.parametrize("host", BEYOND_LOOPBACK)
def test_a_component_of_others_needs_no_accounts_beyond_loopback_and_accepts_nobody(host: str) -> None:
    settings = Settings.load(**CERTIFICATE, host=host)
    require_protection(settings, host, "HANDOVER_HOST", accepts_no_callers=True)
    with pytest.raises(UsageError, match="no TLS"):
        require_protection(Settings.load(), host, "HANDOVER_HOST", accepts_no_callers=True)
    with pytest.raises(Problem, match=r"no public keys of accounts.*copy public-keys.json"):
        Guard(settings, "lamp").authenticate_now("127.0.0.1", {b"host": b"127.0.0.1:9100"})


def test_a_component_of_others_behind_a_proxy_accepts_nobody_either() -> None:
    """The proxy is on this machine, and may send neither the name that was asked for nor its client."""
    settings = Settings.load(**PROXY)
    require_protection(settings, "127.0.0.1", "HANDOVER_HOST", accepts_no_callers=True)
    with pytest.raises(Problem, match="no public keys of accounts"):
        Guard(settings, "lamp").authenticate_now("127.0.0.1", {b"host": b"127.0.0.1:9100"})


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.8.8.8"])
def test_on_loopback_a_server_needs_neither_unless_a_proxy_passes_on_requests(host: str) -> None:
    require_protection(Settings.load(), host, "HANDOVER_HOST")
    with pytest.raises(UsageError, match=r"HANDOVER_TLS_PROXY_URL is .* no accounts"):
        require_protection(Settings.load(**PROXY), host, "HANDOVER_HOST")


def test_the_ports_of_gloves_and_devices_need_them_too() -> None:
    with pytest.raises(UsageError, match=r"HANDOVER_GLOVE_HOST is 0.0.0.0.* no TLS and no accounts"):
        make_app(ControllerSettings.load(glove_host="0.0.0.0"))
    with pytest.raises(UsageError, match=r"HANDOVER_DEVICE_HOST is 0.0.0.0.* no accounts"):
        DeviceServer(GatewaySettings.load(device_host="0.0.0.0", device_plain=True), None)  # type: ignore[arg-type]
