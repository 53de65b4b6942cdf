"""A person with a grant for one robot finds this robot, its camera and no others in the lists."""

from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from handover.database import connect
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Guard
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Role
from handover.security.revocations import FollowedRevocations
from handover.serving.service import create_app
from handover_devices.camera_images import CameraImages
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.edge.edge_app import NoReports
from handover_devices.gateway import DeviceGateway
from handover_devices.model.description import DeviceDescription, DeviceKind
from handover_devices.protocol.times import TimeRule
from handover_devices.registry.device import Device
from handover_devices.routes.camera_routes import add_camera_routes
from handover_devices.routes.device_routes import add_reading_routes
from handover_devices.settings import GatewaySettings
from handover_devices.storage.device_store import StoredDevice
from handover_devices.storage.history_writer import HistoryWriter

KEY = SigningKey.generate()
DEVICES = {"nao-1": DeviceKind.HUMANOID, "nao-2": DeviceKind.HUMANOID, "hall-1": DeviceKind.SENSOR}
Client = Callable[..., httpx.AsyncClient]


@pytest.fixture
def client(tmp_path: Path) -> Client:
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    settings = GatewaySettings(data_dir=tmp_path, _env_file=None)
    engine = connect(settings.database("devices"))
    writer = HistoryWriter(engine)
    gateway = DeviceGateway(engine, writer, Dispatcher(engine, writer, 1.0), NoReports(), TimeRule(1.0, 1.0))
    images = CameraImages()
    for name, kind in DEVICES.items():
        gateway.devices[name] = Device(StoredDevice(name, DeviceDescription(kind=kind), None, 0, 0))
        images.put(name, b"\xff\xd8\xff")
    revocations = FollowedRevocations()
    revocations.apply({"position": 1, "revoked": []})
    app = create_app("d", description="d", guard=Guard(settings, "device-gateway", revocations=revocations))
    add_reading_routes(app, settings, gateway, engine)
    add_camera_routes(app, settings, gateway, images)

    def signed_in(*grants: Grant) -> httpx.AsyncClient:
        token = KEY.issue(Caller(CallerKind.USER, "anna", "Anna", grants, revision=1), valid_s=60)
        headers = {"Authorization": f"Bearer {token}"}
        transport = httpx.ASGITransport(app)
        return httpx.AsyncClient(transport=transport, base_url="http://localhost", headers=headers)

    return signed_in


async def names(client: httpx.AsyncClient, path: str, member: str) -> list[str]:
    answer = await client.get(path)
    assert answer.status_code == 200, answer.text
    return [one[member] for one in answer.json()]


async def test_lists_have_what_the_grants_include(client: Client) -> None:
    async with client(Grant(Role.ENGINEER, "urn:ngsi-ld:Device:demo:nao-1")) as anna:
        assert await names(anna, "/devices", "name") == ["nao-1"]
        assert await names(anna, "/devices?kind=sensor", "name") == []
        assert await names(anna, "/cameras", "device") == ["nao-1"]
    async with client(Grant(Role.VIEWER)) as vera:
        assert await names(vera, "/devices", "name") == sorted(DEVICES)
        assert await names(vera, "/devices?kind=humanoid&kind=sensor&limit=2", "name") == ["hall-1", "nao-1"]
    async with client() as eve:
        assert (await eve.get("/devices")).status_code == 403
        assert (await eve.get("/cameras")).status_code == 403
