"""A week before the client certificate of a device expires, an Alert says so, until there is another one."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.alerts.catalogue import DEVICE_CERTIFICATE_EXPIRES
from handover.broker import BrokerClient
from handover.transport_security import local_authority
from handover_devices.app import make_app
from handover_devices.certificate_alerts import CertificateAlerts
from handover_devices.model.description import DeviceDescription
from handover_devices.registry.device import Device
from handover_devices.settings import GatewaySettings
from handover_devices.storage.device_store import StoredDevice
from services.device_gateway.tests.integration.conftest import SENSOR, broker_in_process
from tests.kit.cell import Cell
from tests.kit.certificates import Certificates
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

NOW_S = 1_767_225_600.0
DEVICE = "urn:ngsi-ld:Device:demo:"


def device(name: str, expires_in: timedelta | None) -> Device:
    description = DeviceDescription.model_validate({"kind": "sensor"})
    end_us = None if expires_in is None else int((NOW_S + expires_in.total_seconds()) * 1e6)
    return Device(StoredDevice(name, description, None, 0, 0, None if end_us is None else "f" * 64, end_us))


async def active(broker: BrokerClient) -> dict[str, str]:
    """Return the descriptions of the active Alerts by the names of their devices."""
    return {
        alert["alertSource"]["object"].removeprefix(DEVICE): alert["description"]["value"]
        for alert in await broker.query(type="Alert")
        if alert["subCategory"]["value"] == DEVICE_CERTIFICATE_EXPIRES.sub_category and "validTo" not in alert
    }


@asynccontextmanager
async def in_process(folder: Path) -> AsyncIterator[tuple[GatewaySettings, BrokerClient]]:
    settings = GatewaySettings.load(data_dir=folder)
    async with broker_in_process(folder) as broker:
        yield settings, BrokerClient(settings, transport=httpx.ASGITransport(broker))


async def test_an_alert_is_raised_a_week_before_the_end(tmp_path: Path) -> None:
    ends = {
        "without": None,
        "ended": timedelta(days=-1),
        "tonight": timedelta(hours=6),
        "in-a-week": timedelta(days=6, hours=23),
        "later": timedelta(days=7, hours=1),
    }
    devices = {name: device(name, end) for name, end in ends.items()}
    async with in_process(tmp_path) as (settings, broker):
        await CertificateAlerts(settings, broker, devices, lambda: NOW_S).look()
        found = await active(broker)
        assert found.keys() == {"ended", "tonight", "in-a-week"}
        assert "handover device certificate tonight" in found["tonight"]


async def test_a_new_certificate_revocation_and_deletion_clear_it(tmp_path: Path) -> None:
    devices = {
        name: device(name, timedelta(days=1)) for name in ("new", "revoked", "deleted", "away", "a", "a-")
    }
    async with in_process(tmp_path) as (settings, broker):
        alerts = CertificateAlerts(settings, broker, devices, lambda: NOW_S)
        await alerts.look()
        assert (await active(broker)).keys() == devices.keys()
        devices["new"] = device("new", timedelta(days=397))
        devices["revoked"] = device("revoked", None)
        del devices["deleted"]
        await alerts.look()
        assert (await active(broker)).keys() == {"away", "a", "a-"}
        devices["away"] = device("away", timedelta(days=397))
        restarted = CertificateAlerts(settings, broker, devices, lambda: NOW_S)
        await restarted.look()
        assert (await active(broker)).keys() == {"a", "a-"}
        devices["new"] = replace(devices["new"], stored=device("new", timedelta(days=2)).stored)
        await restarted.look()
        assert (await active(broker)).keys() == {"a", "a-", "new"}


@pytest.mark.nightly
async def test_the_gateway_raises_it_when_such_a_certificate_is_made(
    shared_cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared_cell.run("context_broker")
    certificates = Certificates(tmp_path / "certificates")
    files = certificates.make("127.0.0.1")
    monkeypatch.setattr(local_authority, "SERVER_LIFETIME", timedelta(days=2))
    settings = GatewaySettings.load(
        broker_url=shared_cell.url("context_broker"),
        broker_tenant=shared_cell.tenant or None,
        data_dir=tmp_path,
        device_port=next_free_port(),
        device_tls_certificate=files.certificate,
        device_tls_key=files.key,
        authority_dir=certificates.authority.folder,
    )
    app = make_app(settings)
    transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as rest,
        BrokerClient(settings) as broker,
    ):
        body: dict[str, Any] = {"name": "short-1", "description": SENSOR}
        (await rest.post("/devices", json=body)).raise_for_status()
        (await rest.post("/devices/short-1/certificate")).raise_for_status()

        async def is_raised() -> bool:
            return "short-1" in await active(broker)

        async def is_cleared() -> bool:
            return not await is_raised()

        await until(is_raised)
        (await rest.delete("/devices/short-1/certificate")).raise_for_status()
        await until(is_cleared)
        (await rest.delete("/devices/short-1")).raise_for_status()
