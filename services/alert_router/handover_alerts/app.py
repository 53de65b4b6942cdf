"""The alert router: sends Alerts to people by mail, webhook and messenger, by rules, and keeps a log."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service_addresses import ALERT_ROUTER
from handover.serving.leadership import Leadership, OnlyLeading
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_alerts.directory import Directory
from handover_alerts.follower import Follower
from handover_alerts.model.configuration import Configuration, read_configuration
from handover_alerts.routes.channels import add_routes
from handover_alerts.senders import Senders
from handover_alerts.sending import Sending
from handover_alerts.settings import RouterSettings
from handover_alerts.storage import tables
from handover_alerts.storage.store import Store


def make_app(settings: RouterSettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    engine = connect(settings.database("alerts"))
    guard = Guard(settings, ALERT_ROUTER)
    broker = BrokerClient(settings, credentials=guard.access)
    leadership = Leadership(engine, ALERT_ROUTER)
    store = Store(engine, leadership.transaction)
    file = settings.alert_routes
    directory = Directory(store, Configuration() if file is None else read_configuration(file))
    senders = Senders(settings)
    sending = Sending(store, senders, directory.channels.get)
    follower = Follower(settings, broker, store, lambda: directory.routes, sending.wake)

    @asynccontextmanager
    async def leading() -> AsyncIterator[None]:
        await directory.load()
        await follower.load()
        async with BackgroundTasks("alert router") as tasks:
            for work in (sending.run, follower.run, follower.take_steps, follower.keep_retention):
                tasks.start_restarting(work)
            yield

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        tables.prepare(engine)
        follower.receiver.require_key()
        async with broker, leadership.led(leading):
            yield
        senders.close()
        engine.dispose()

    app = create_app(
        "Alert router",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "leadership": leadership.check,
            "broker": broker.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, ALERT_ROUTER, engine),
    )
    app.add_middleware(OnlyLeading, leadership=leadership)
    add_routes(app, store, directory, senders, follower)
    return app
