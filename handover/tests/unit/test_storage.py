"""Storage: a service that cannot keep what it must is not ready, and says where and why."""

import asyncio
import shutil
from pathlib import Path

import httpx
import pytest

from handover.serving.service import create_app
from handover.serving.storage import MIN_FREE_BYTES, require_storage, storage_check


def asked(folder: Path) -> httpx.Response:
    async def ask() -> httpx.Response:
        app = create_app("Lamp", description="", checks={"storage": storage_check(folder)})
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://lamp") as http:
            return await http.get("/readyz")

    return asyncio.run(ask())


def test_a_service_with_room_is_ready_also_before_its_directory_is_made(tmp_path: Path) -> None:
    assert asked(tmp_path / "not" / "yet").json() == {"status": "ready"}


def test_a_service_on_a_full_disk_is_not_ready_and_names_directory_and_free_bytes(tmp_path: Path) -> None:
    free = shutil.disk_usage(tmp_path).free
    with pytest.raises(OSError, match=rf"{tmp_path} has \d+ bytes free, and {free * 2} are needed"):
        require_storage(tmp_path, free * 2)


def test_a_service_whose_directory_is_read_only_is_not_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "os.access", lambda *_: False
    )  # as on a disk that is mounted so; root may write anywhere
    answer = asked(tmp_path)
    assert answer.status_code == 503
    assert f"{tmp_path} is read-only" in answer.json()["storage"]


def test_a_full_disk_is_one_of_less_than_the_databases_need() -> None:
    assert MIN_FREE_BYTES >= 4 * 1024 * 1024
