"""A component with one performer: runs a `Performer` class as a service.

serve(Lamp, "lamp", acts_for=["Device:lamp-1"], port=9100)
"""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.performer import Performer
from handover.security.guard import Guard
from handover.serving.server import serve as serve_app
from handover.serving.service import create_app
from handover.settings import Settings


def component_app(
    performer_class: Callable[..., Performer],
    name: str,
    settings: Settings,
    *,
    acts_for: Sequence[str],
    url: str,
) -> FastAPI:
    """Return the application of a performer; `url` is its address for the broker.

    `acts_for` are the resources whose Tasks it executes: `Type:id` or URNs.
    """
    guard = Guard(settings, name)
    broker = BrokerClient(settings, credentials=guard.access)
    performer = performer_class(name, settings, broker, notify_url=f"{url}/notifications")

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        for resource in acts_for:
            kind, short = resource.split(":", 1)
            await performer.act_for(resource if kind == "urn" else settings.entity_id(kind, short))
        async with broker, performer:
            yield

    app = create_app(
        name,
        description=performer_class.__doc__ or name,
        lifespan=lifespan,
        checks={"tasks": performer.probe},
        guard=guard,
    )
    performer.mount(app)
    return app


def serve(
    performer_class: Callable[..., Performer],
    name: str,
    *,
    acts_for: Sequence[str],
    port: int,
    url: str | None = None,
) -> None:
    """Run a performer as a service on `port` until it is stopped.

    `url` is its address for the broker, by default HANDOVER_COMPONENT_URL or the address on which it listens.
    """
    settings = Settings.load()
    own_url = settings.url_of(port, url or settings.component_url)
    serve_app(
        lambda: component_app(performer_class, name, settings, acts_for=acts_for, url=own_url),
        settings,
        service=name,
        port=port,
        port_setting=f"the port of {name}",
        urls=[own_url],
        is_component=True,
    )
