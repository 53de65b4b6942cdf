"""The streams of scans and depth images of people over WebSocket, for all robots of the cell."""

from collections.abc import Awaitable, Callable

from fastapi import FastAPI
from starlette.websockets import WebSocket

from handover.security.guard import require
from handover.security.permissions import Permission
from handover_datamodels.streams import DepthReport, PeopleReport, ScanReport
from handover_robots.people.measured import SceneSensors
from handover_robots.routes.report_stream import receive_reports

MAX_SCAN_BYTES, MAX_DEPTH_BYTES = 64 * 1024, 320 * 1024

Receive = Callable[[PeopleReport], Awaitable[None]]


def add_routes(app: FastAPI, sensors: SceneSensors, receive: Receive) -> None:
    """Add the streams; `receive` gives a report to the limits of every robot."""

    @app.websocket("/cell/scans", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def scans(sender: WebSocket) -> None:
        async def receive_scan(scan: ScanReport) -> None:
            await receive(sensors.of_scan(scan))

        await sender.accept()
        await receive_reports(sender, "scan", ScanReport, receive_scan, MAX_SCAN_BYTES)

    @app.websocket("/cell/depth_images", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def depth_images(sender: WebSocket) -> None:
        async def receive_image(image: DepthReport) -> None:
            await receive(sensors.of_depth(image))

        await sender.accept()
        await receive_reports(sender, "depth image", DepthReport, receive_image, MAX_DEPTH_BYTES)
