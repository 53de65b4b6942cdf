"""Services of other packages: found by their entry points, with the reason if they cannot be loaded."""

from collections.abc import Callable
from pathlib import Path

import pytest

from handover_web.settings import WebuiSettings
from handover_web.sources.extra_services import ExtraService, extra_services

MODULE = """
from pydantic import Field
from handover.extensions import Service
from handover.settings import Settings

class BellSettings(Settings):
    bell_port: int = Field(54901, description="port")
    bell_url: str | None = Field(None, description="URL")

SERVICE = Service("bell", "bell_service", BellSettings, "bell_port")
NO_SERVICE = 7
"""

Register = Callable[[str], None]


@pytest.fixture
def register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Register:
    """Register entry points of `handover.services` as an installed package does."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(entries: str) -> None:
        (tmp_path / "bell_service.py").write_text(MODULE)
        metadata = tmp_path / "bell_service-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: bell-service\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[handover.services]\n{entries}\n")

    return write


def test_a_wanted_service_has_the_url_of_its_settings(
    register: Register, monkeypatch: pytest.MonkeyPatch
) -> None:
    register("bell = bell_service:SERVICE")
    settings = WebuiSettings.load(extra_services=("bell",))
    assert list(extra_services(settings)) == [ExtraService("bell", "http://127.0.0.1:54901", is_wanted=True)]
    monkeypatch.setenv("HANDOVER_BELL_URL", "http://bell:8000/")
    assert [one.url for one in extra_services(settings)] == ["http://bell:8000"]


def test_an_installed_service_is_wanted_unless_the_cell_names_others(register: Register) -> None:
    register("bell = bell_service:SERVICE")
    [bell] = extra_services(WebuiSettings.load())
    assert bell.is_wanted
    [bell] = extra_services(WebuiSettings.load(extra_services=()))
    assert not bell.is_wanted


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ("bell = bell_service:NO_SERVICE", "is no handover.extensions.Service"),
        ("bell = no_such_module:SERVICE", "cannot be loaded: ModuleNotFoundError"),
        ("horn = bell_service:SERVICE", 'there is no service "bell"; there are: '),
    ],
)
def test_a_wanted_service_that_cannot_be_loaded_has_the_reason(
    register: Register, entry: str, why: str
) -> None:
    register(entry)
    [bell] = [one for one in extra_services(WebuiSettings.load(extra_services=("bell",))) if one.is_wanted]
    assert bell.url is None
    assert why in str(bell.fault)


def test_a_registered_service_that_cannot_be_loaded_is_left_out_unless_it_is_wanted(
    register: Register,
) -> None:
    register("bell = no_such_module:SERVICE")
    assert list(extra_services(WebuiSettings.load())) == []
