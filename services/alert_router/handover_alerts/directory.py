"""The channels and routes in force: those of the file, and those that were added by REST."""

import asyncio
from typing import Any

import orjson
from pydantic import TypeAdapter, ValidationError

from handover.telemetry import get_logger
from handover_alerts.model.configuration import AppriseChannel, Channel, Configuration, Route, WebhookChannel
from handover_alerts.storage.store import Store

log = get_logger(__name__)

_CHANNEL: TypeAdapter[Channel] = TypeAdapter(Channel)


class Directory:
    """All channels and routes by name; those `in_file` cannot be changed by REST."""

    def __init__(self, store: Store, in_file: Configuration) -> None:
        self.in_file = in_file
        self.channels: dict[str, Channel] = dict(in_file.channels)
        self.routes: dict[str, Route] = dict(in_file.routes)
        self._store = store

    async def load(self) -> None:
        """Read what was stored; what is in the file as well is as in the file."""
        channels, routes = await asyncio.to_thread(self._store.configuration)
        for name, text in channels.items():
            try:
                self.channels.setdefault(name, _CHANNEL.validate_json(text))
            except ValidationError as error:
                log.warning("stored channel not used", channel=name, error=str(error))
        for name, text in routes.items():
            try:
                self.routes.setdefault(name, Route.model_validate_json(text))
            except ValidationError as error:
                log.warning("stored route not used", route=name, error=str(error))

    async def set_channel(self, name: str, channel: Channel | None) -> None:
        """Store a channel; None deletes it."""
        text = None if channel is None else orjson.dumps(_revealed(channel)).decode()
        await asyncio.to_thread(self._store.save_channel, name, text)
        if channel is None:
            self.channels.pop(name, None)
        else:
            self.channels[name] = channel

    async def set_route(self, name: str, route: Route | None) -> None:
        """Store a route; None deletes it."""
        text = None if route is None else route.model_dump_json(by_alias=True)
        await asyncio.to_thread(self._store.save_route, name, text)
        if route is None:
            self.routes.pop(name, None)
        else:
            self.routes[name] = route

    def users_of(self, channel: str) -> list[str]:
        """Return the routes that use a channel."""
        return sorted(name for name, route in self.routes.items() if channel in route.used_channels())


def _revealed(channel: Channel) -> Any:
    """Return a channel as it is stored, with its secret."""
    document = channel.model_dump(mode="json", by_alias=True)
    if isinstance(channel, WebhookChannel) and channel.secret is not None:
        document["secret"] = channel.secret.get_secret_value()
    if isinstance(channel, AppriseChannel):
        document["url"] = channel.url.get_secret_value()
    return document
