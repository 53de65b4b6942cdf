"""REST of cameras: devices send images with their tokens, and people see the newest one."""

import time
from typing import Annotated, Final

from fastapi import Depends, FastAPI, Header, Request, Response
from pydantic import BaseModel, ConfigDict
from pydantic.alias_generators import to_camel

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.http.body_limit import max_body
from handover.security.guard import OtherCredential, in_path, require
from handover.security.permissions import Permission
from handover.serving.service import accepts
from handover_devices.camera_images import MAX_IMAGE_BYTES, CameraImages
from handover_devices.gateway import DeviceGateway
from handover_devices.registry.pictures import PICTURE_TYPES
from handover_devices.routes.access import Reader, may_read
from handover_devices.settings import GatewaySettings

OF_DEVICE = in_path("Device", "device")
INGEST: Final = "/ingest/{device}/image"


class CameraView(BaseModel):
    """A device that has sent images since the gateway started: the number of the newest one, and its age."""

    model_config = ConfigDict(alias_generator=to_camel, populate_by_name=True)

    device: str
    title: str
    number: int
    age_s: float


def add_camera_routes(
    app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway, images: CameraImages
) -> None:
    """Add the routes of cameras."""
    routes = TaggedRoutes(app, "devices")

    @routes.post(INGEST, status_code=204, dependencies=[Depends(OtherCredential("the token of the device"))])
    @max_body(MAX_IMAGE_BYTES)
    @accepts(*PICTURE_TYPES)
    async def put_image(device: str, request: Request, authorization: Annotated[str, Header()] = "") -> None:
        """Receive an image of a camera, PNG, JPEG or WebP; `Authorization: Bearer` has its token.

        It replaces the one before, and is never stored.
        """
        scheme, _, token = authorization.partition(" ")
        sender = gateway.authorized(device, token.strip() if scheme.lower() == "bearer" else "")
        images.put(sender.name, await request.body())

    @routes.get("/cameras")
    async def cameras(caller: Reader) -> list[CameraView]:
        """List the devices that have sent images and that the caller may read, with the age of the newest."""
        now_s, views = time.time(), []
        for name, device in sorted(gateway.devices.items()):
            if (image := images.of(name)) is not None and may_read(caller, settings, name):
                age_s = round(max(now_s - image.at_s, 0.0), 3)
                title = device.stored.description.title
                views.append(CameraView(device=name, title=title, number=image.number, age_s=age_s))
        return views

    @routes.get(
        "/devices/{device}/image",
        response_class=Response,
        responses=sends("image/*"),
        dependencies=[require(Permission.READ, OF_DEVICE)],
    )
    async def image(device: str) -> Response:
        """Return the newest image of a camera; 404 if it has sent none since the gateway started."""
        gateway.device(device)
        newest = images.of(device)
        if newest is None:
            raise Problem.translated(
                404, "No image", "device.no_image", "{device} has sent no image yet", device=device
            )
        return Response(newest.content, media_type=newest.media_type, headers={"Cache-Control": "no-store"})
