"""Human state: sensors of persons who consent, their state, and speed limits for robots.

Nothing here is a medical device or a safety-rated function.
"""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from fastapi import FastAPI

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import UsageError
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.garbage_collection import freeze_loaded
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.security.keys_in_force import KeysInForce
from handover.service_addresses import HUMAN_STATE
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_body.exchange.deletions import Deletions
from handover_body.exchange.health_entities import HealthEntities
from handover_body.metrics import REJECTED
from handover_body.monitoring.activities import ActivityModel
from handover_body.monitoring.breaks import BreakProposals
from handover_body.monitoring.entities import HumanStates
from handover_body.monitoring.history import HistoryWriter
from handover_body.monitoring.lsl_feed import LslFeed
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.processors import pipeline_of
from handover_body.monitoring.removal import Removal
from handover_body.people.people import People
from handover_body.recording.service import RecordingService
from handover_body.routes.access_routes import add_access_routes
from handover_body.routes.foxglove_socket import add_foxglove
from handover_body.routes.parts import Parts
from handover_body.routes.people_routes import add_people_routes
from handover_body.routes.recording_routes import add_recording_routes
from handover_body.routes.sensor_routes import add_sensor_routes
from handover_body.routes.streams import add_streams
from handover_body.settings import HumanStateSettings
from handover_body.storage import tables
from handover_body.storage.store import Store


def make_app(settings: HumanStateSettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    _require_accounts_for_lsl(settings)
    engine = connect(settings.database("human-state"))
    guard = Guard(settings, HUMAN_STATE)
    broker = BrokerClient(settings, credentials=guard.access)
    store = Store(engine)
    people = People(store)
    tasks = BackgroundTasks("human state")
    writer = reporting_writer(HUMAN_STATE, settings, broker, REJECTED)
    deletions = Deletions(settings, broker, writer)
    activities = ActivityModel(settings.health_activity_model, tasks)
    monitoring = Monitoring(
        settings, people, guard.access, tasks, pipeline_of=pipeline_of, classifier_of=activities.classifier
    )
    health = HealthEntities(settings, broker)
    entities = HumanStates(settings, monitoring, health, writer, deletions)
    history = HistoryWriter(store, monitoring, settings.health_history_days)
    breaks = BreakProposals(settings, guard.access)
    recording = RecordingService(
        settings,
        store=store,
        people=people,
        monitoring=monitoring,
        tasks=tasks,
        broker=broker,
        health=health,
        writer=writer,
        deletions=deletions,
    )
    removal = Removal(people, store, history, entities, recording.recordings.delete_of)

    def changed(name: str) -> None:
        monitoring.apply(name)
        recording.apply(name)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        await asyncio.to_thread(tables.prepare, engine)
        await people.load()
        async with broker, writer, tasks:
            people.on_changed = changed
            monitoring.on_stopped = entities.ended
            monitoring.on_strain = lambda monitor: tasks.start(breaks.propose, monitor)
            for person in people.all():
                monitoring.apply(person.name)
            tasks.start_restarting(monitoring.run)
            tasks.start_restarting(freeze_loaded)
            tasks.start_restarting(history.run)
            tasks.start_restarting(entities.run)
            writer.put("orphans", lambda: entities.delete_orphans(people))
            with _lsl_feed(settings, monitoring, tasks):
                await recording.open()
                yield
            await recording.close()
            people.on_changed = lambda _: None
        breaks.close()
        engine.dispose()

    audit = AuditTrail(settings, HUMAN_STATE, engine, has_names=True)
    app = create_app(
        "Human state",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"broker": broker.probe, "storage": storage_check(settings.data_dir)},
        guard=guard,
        audit=audit,
    )
    parts = Parts(people, monitoring, store, removal)
    add_people_routes(app, parts)
    add_sensor_routes(app, parts)
    add_access_routes(app, people, audit)
    add_recording_routes(app, people, recording)
    add_streams(app, monitoring)
    add_foxglove(app, monitoring)
    return app


def _require_accounts_for_lsl(settings: HumanStateSettings) -> None:
    """Raise `UsageError` if signals would leave a machine in local mode; LSL has no access control."""
    if settings.health_lsl_people and KeysInForce(settings.security_folder).keys() is None:
        raise UsageError(
            "HANDOVER_HEALTH_LSL_PEOPLE sends signals of the body to the local network, and there are no "
            "accounts; run `handover accounts set-up`, or leave the setting out"
        )


@contextmanager
def _lsl_feed(settings: HumanStateSettings, monitoring: Monitoring, tasks: BackgroundTasks) -> Iterator[None]:
    """Send what is live to LSL, if the settings ask for it."""
    if not settings.health_lsl_people:
        yield
        return
    feed = LslFeed(monitoring, settings.health_lsl_people, settings.health_lsl_signals)
    tasks.start_restarting(feed.run)
    try:
        yield
    finally:
        feed.close()
