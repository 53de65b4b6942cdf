"""REST of the adapters: which are configured, and whether they reach their devices."""

from collections.abc import Mapping

from fastapi import FastAPI
from typing_extensions import TypedDict

from handover.security.guard import require
from handover.security.permissions import Permission
from handover_devices.adapters.base import Adapter


class AdapterView(TypedDict):
    """An adapter; `fault` is None while it reaches its devices or its server."""

    name: str
    fault: str | None


def add_adapter_routes(app: FastAPI, adapters: Mapping[str, Adapter]) -> None:
    """Add the route of the adapters."""

    @app.get("/adapters", tags=["devices"], dependencies=[require(Permission.READ)])
    async def list_adapters() -> list[AdapterView]:
        """List the adapters that are configured, such as MQTT."""
        return [{"name": name, "fault": adapter.fault} for name, adapter in adapters.items()]
