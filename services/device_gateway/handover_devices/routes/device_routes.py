"""REST of the registry: devices are added, viewed, edited and deleted; their tokens, URDFs and pictures."""

import asyncio
import time
from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from pydantic import ConfigDict
from sqlalchemy import Engine

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import sends
from handover.http.body_limit import max_body
from handover.security.guard import in_path, require, require_by_handler, require_somewhere
from handover.security.permissions import Permission
from handover.serving.service import XML_TYPES, accepts, json_response
from handover_devices.gateway import DeviceGateway
from handover_devices.model.description import DeviceDescription, DeviceKind
from handover_devices.model.units import SYMBOLS
from handover_devices.registry.certificates import new_certificate
from handover_devices.registry.device import Device
from handover_devices.registry.entities import device_id
from handover_devices.registry.free_names import FreeNames
from handover_devices.registry.pictures import MAX_PICTURE_BYTES, PICTURE_TYPES, media_type_of
from handover_devices.registry.templates import template, templates
from handover_devices.registry.urdf import MAX_URDF_BYTES, joints_in
from handover_devices.routes.access import Reader, may_read
from handover_devices.routes.views import (
    CertificateView,
    DeviceDetails,
    DeviceView,
    TokenView,
    device_details,
    device_view,
    token_view,
)
from handover_devices.settings import GatewaySettings
from handover_devices.storage import device_store
from handover_devices.storage.device_store import DeviceFile

MAX_DESCRIPTION_BYTES = 512 * 1024
OF_DEVICE = in_path("Device", "device")
CAN_READ = require(Permission.READ, OF_DEVICE)
CAN_CONFIGURE = require(Permission.CONFIGURE, OF_DEVICE)
URDF, PICTURE = "urdf", "picture"


class NewDevice(StrictModel):
    """A device to add: its name, and a template or a description."""

    model_config = ConfigDict(extra="forbid")

    name: str
    template: str | None = None
    description: DeviceDescription | None = None

    def described(self) -> DeviceDescription:
        """Return the description; raise `Problem` if there is none, or two."""
        if (self.template is None) == (self.description is None):
            raise Problem.translated(
                422, "No description", "device.no_description", "give either a template or a description"
            )
        if self.template is not None:
            return template(self.template)
        assert self.description is not None  # noqa: S101 - one of them is given
        return self.description


def add_device_routes(
    app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway, engine: Engine, broker: BrokerClient
) -> None:
    """Add the routes of the registry."""
    _add_catalogues(app)
    _add_credentials(app, settings, gateway)
    add_reading_routes(app, settings, gateway, engine)
    names = FreeNames(broker)

    async def details(device: Device) -> DeviceDetails:
        return await _details(settings, engine, device)

    @app.post("/devices", status_code=201, tags=["devices"], dependencies=[require(Permission.CONFIGURE)])
    @max_body(MAX_DESCRIPTION_BYTES)
    async def add(new: NewDevice) -> TokenView:
        """Register a device; its token is shown only once. Its entities are written to the broker."""
        description = new.described()
        await names.require_free(device_id(settings, new.name))
        made = await gateway.add(new.name, description)
        return token_view(new.name, made.token, settings)

    @app.put("/devices/{device}", tags=["devices"], dependencies=[CAN_CONFIGURE])
    @max_body(MAX_DESCRIPTION_BYTES)
    async def describe(device: str, description: DeviceDescription) -> DeviceDetails:
        """Replace the description of a device."""
        return await details(await gateway.describe(device, description))

    @app.delete("/devices/{device}", status_code=204, tags=["devices"], dependencies=[CAN_CONFIGURE])
    async def remove(device: str) -> None:
        """Delete a device with its history, its token and its entities."""
        await gateway.remove(device)

    @app.put("/devices/{device}/urdf", tags=["devices"], dependencies=[CAN_CONFIGURE])
    @max_body(MAX_URDF_BYTES)
    @accepts(*XML_TYPES)
    async def set_urdf(
        device: str,
        request: Request,
        joints: Annotated[bool, Query(description="also replace the joints by those of the URDF")] = False,
    ) -> DeviceDetails:
        """Store the URDF of a robot."""
        registered = gateway.device(device)
        urdf = await request.body()
        joints_of_file = await asyncio.to_thread(joints_in, urdf)
        await gateway.save_file(device, URDF, DeviceFile("application/xml", urdf))
        if joints:
            changed = registered.stored.description.model_dump() | {"joints": joints_of_file}
            await gateway.describe(device, DeviceDescription.model_validate(changed))
        return await details(registered)

    @app.get(
        "/devices/{device}/urdf",
        tags=["devices"],
        response_class=Response,
        responses=sends("application/xml"),
        dependencies=[CAN_READ],
    )
    async def urdf(device: str) -> Response:
        """Return the URDF of a robot."""
        return await _file(device, URDF)

    @app.put("/devices/{device}/picture", status_code=204, tags=["devices"], dependencies=[CAN_CONFIGURE])
    @max_body(MAX_PICTURE_BYTES)
    @accepts(*PICTURE_TYPES)
    async def set_picture(device: str, request: Request) -> None:
        """Store a picture of a device: PNG, JPEG or WebP."""
        content = await request.body()
        await gateway.save_file(device, PICTURE, DeviceFile(media_type_of(content), content))

    @app.get(
        "/devices/{device}/picture",
        tags=["devices"],
        response_class=Response,
        responses=sends(*PICTURE_TYPES),
        dependencies=[CAN_READ],
    )
    async def picture(device: str) -> Response:
        """Return the picture of a device."""
        return await _file(device, PICTURE)

    async def _file(device: str, kind: str) -> Response:
        gateway.device(device)
        file = await asyncio.to_thread(device_store.file_of, engine, device, kind)
        if file is None:
            raise Problem.translated(
                404,
                f"No {kind}",
                "device.no_file",
                "{device} has no {kind}; upload one with PUT on this address",
                device=device,
                kind=kind,
            )
        return Response(
            file.content, media_type=file.media_type, headers={"X-Content-Type-Options": "nosniff"}
        )


def add_reading_routes(
    app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway, engine: Engine
) -> None:
    """Add the routes that list devices; an edge has no others of the registry."""

    @app.get("/devices", tags=["devices"], response_model=list[DeviceView])
    async def devices(
        caller: Reader,
        limit: Annotated[int, Query(ge=1, le=1000)] = 1000,
        after: str = "",
        kind: Annotated[tuple[DeviceKind, ...], Query(description="only devices of these kinds")] = (),
    ) -> Response:
        """List the devices that the caller may read with their latest values, by name.

        `after` is the last name of the page before.
        """
        matches = sorted(
            name
            for name, device in gateway.devices.items()
            if name > after
            and (not kind or device.stored.description.kind in kind)
            and may_read(caller, settings, name)
        )
        now_s = time.time()
        return json_response(
            [device_view(gateway.devices[name], device_id(settings, name), now_s) for name in matches[:limit]]
        )

    @app.get("/devices/{device}", tags=["devices"], dependencies=[CAN_READ])
    async def one(device: str) -> DeviceDetails:
        """Return a device with its description."""
        return await _details(settings, engine, gateway.device(device))


async def _details(settings: GatewaySettings, engine: Engine, device: Device) -> DeviceDetails:
    files = await asyncio.to_thread(device_store.files_of, engine, device.name)
    return device_details(device, device_id(settings, device.name), time.time(), files)


def _add_credentials(app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway) -> None:
    @app.post("/devices/{device}/token", tags=["devices"], dependencies=[CAN_CONFIGURE])
    async def change_token(device: str) -> TokenView:
        """Make a new token, shown only once; the old one and its connection end."""
        made = await gateway.change_token(device)
        return token_view(device, made.token, settings)

    @app.delete("/devices/{device}/token", status_code=204, tags=["devices"], dependencies=[CAN_CONFIGURE])
    async def revoke_token(device: str) -> None:
        """Revoke the token: the device is disconnected and cannot connect until it gets a new one."""
        await gateway.revoke_token(device)

    @app.post("/devices/{device}/certificate", tags=["devices"], dependencies=[CAN_CONFIGURE])
    async def make_certificate(device: str) -> CertificateView:
        """Make a client certificate, an alternative to the token; its key is shown only once.

        The one before ends at once, with its connection. The token stays: revoke it if it is not needed.
        """
        gateway.device(device)
        made = await asyncio.to_thread(new_certificate, settings, device)
        await gateway.set_certificate(device, made.sha256, made.end_us)
        return {
            "name": device,
            "certificate": made.certificate,
            "key": made.key,
            "authority": made.authority,
            "endsAt": made.end_us / 1e6,
        }

    @app.delete(
        "/devices/{device}/certificate", status_code=204, tags=["devices"], dependencies=[CAN_CONFIGURE]
    )
    async def revoke_certificate(device: str) -> None:
        """Revoke the certificate: the device is disconnected and cannot connect with it any more."""
        await gateway.set_certificate(device, None, None)


def _add_catalogues(app: FastAPI) -> None:
    @app.get("/templates", tags=["devices"], dependencies=[require_by_handler(Permission.READ)])
    async def list_templates() -> dict[str, DeviceDescription]:
        """Return the descriptions of known robots by name."""
        return templates()

    @app.get("/units", tags=["devices"], dependencies=[require_somewhere(Permission.READ)])
    async def list_units() -> dict[str, str]:
        """Return the symbols of units by their UN/CEFACT codes; other codes are accepted as well."""
        return dict(SYMBOLS)
