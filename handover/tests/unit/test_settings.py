"""Settings: one prefix, and one readable line for a wrong one."""

from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, SecretStr

from handover.errors import UsageError
from handover.settings import Settings, origins


class LampSettings(Settings):
    lamp_port: int = Field(9000, description="where the lamp listens")
    lamp_token: SecretStr = Field(SecretStr(""), description="what a lamp must say")

    removed: ClassVar = {"lamp_glow_s": "a lamp glows for 2 s"}


def test_a_value_comes_from_the_environment_before_the_file_before_the_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".env").write_text("HANDOVER_FACTORY=from-file\nHANDOVER_LAMP_PORT=9001\n")
    monkeypatch.setenv("HANDOVER_LAMP_PORT", "9002")
    seen = {setting.name: setting for setting in origins([LampSettings])}
    assert (seen["HANDOVER_LAMP_PORT"].value, seen["HANDOVER_LAMP_PORT"].origin) == ("9002", "environment")
    assert (seen["HANDOVER_FACTORY"].value, seen["HANDOVER_FACTORY"].origin) == ("from-file", ".env")
    assert seen["HANDOVER_HOST"].origin == "default"


@pytest.mark.parametrize("place", ["environment", ".env"])
def test_a_removed_setting_raises_one_warning_that_names_what_holds_instead(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover.settings._looked_for", set())
    monkeypatch.chdir(tmp_path)
    if place == "environment":
        monkeypatch.setenv("HANDOVER_LAMP_GLOW_S", "any text")
    else:
        (tmp_path / ".env").write_text("HANDOVER_LAMP_GLOW_S=3\n")
    text = "HANDOVER_LAMP_GLOW_S has no effect .*: a lamp glows for 2 s;"
    with pytest.warns(FutureWarning, match=text) as seen:
        assert LampSettings.load().lamp_port == LampSettings.load().lamp_port
    assert len(seen) == 1


def test_secrets_are_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDOVER_LAMP_TOKEN", "sesame")
    monkeypatch.setenv("HANDOVER_DATABASE_URL", "postgresql://lamp:sesame@host/name")
    assert "sesame" not in repr(list(origins([LampSettings])))
    assert "postgresql://lamp:********@host/name" in repr(list(origins([LampSettings])))


def test_a_wrong_setting_is_named_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDOVER_LAMP_PORT", "ninety")
    with pytest.raises(UsageError, match=r"^setting HANDOVER_LAMP_PORT: .*integer") as wrong:
        LampSettings.load()
    assert "\n" not in str(wrong.value)


@pytest.mark.parametrize(
    "url", ["http://broker:1026/", "http://broker:1026/ngsi-ld/v1", "http://broker:1026"]
)
def test_a_broker_url_is_taken_with_or_without_its_path(url: str) -> None:
    assert Settings.load(broker_url=url).broker_url == "http://broker:1026"


@given(port=st.integers(1, 65535), has_certificate=st.booleans())
def test_the_broker_is_that_of_this_machine_unless_a_url_names_another(
    port: int, has_certificate: bool
) -> None:
    certificate = {"tls_certificate": Path("cell.pem")} if has_certificate else {}
    scheme = "https" if has_certificate else "http"
    settings = Settings.load(broker_port=port, **certificate)
    assert settings.broker_url == f"{scheme}://127.0.0.1:{port}"
    other = Settings.load(broker_port=port, broker_url="http://broker:1026", **certificate)
    assert other.broker_url == "http://broker:1026"


def test_names_are_listed_with_commas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDOVER_ALLOWED_HOSTS", "panel-3, panel-3.hall.example ,")
    assert Settings.load().allowed_hosts == ("panel-3", "panel-3.hall.example")
    assert Settings.load(allowed_hosts=()).allowed_hosts == ()


@pytest.mark.parametrize("origin", ["panel.example", "ftp://panel.example", "https://panel.example/work"])
def test_what_is_no_origin_is_refused_in_one_line(origin: str) -> None:
    with pytest.raises(UsageError, match=r"^setting HANDOVER_ALLOWED_ORIGINS: .*is no origin"):
        Settings.load(allowed_origins=(origin,))


@pytest.mark.parametrize("key", ["short", "with spaces in the middle of it", "umläute-umläute-umläute"])
def test_a_notification_key_can_be_a_header(key: str) -> None:
    with pytest.raises(UsageError, match=r"^setting HANDOVER_NOTIFICATION_KEY: .*16 to 200"):
        Settings.load(notification_key=key)


def test_a_name_becomes_an_id_of_this_factory_and_an_id_stays() -> None:
    settings = Settings.load(factory="plant")
    assert settings.entity_id("Device", "ur10-1") == "urn:ngsi-ld:Device:plant:ur10-1"
    assert settings.entity_id("Device", "urn:ngsi-ld:Device:x:y") == "urn:ngsi-ld:Device:x:y"
