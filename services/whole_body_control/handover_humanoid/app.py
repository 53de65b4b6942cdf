"""Whole-body control: a humanoid in simulation, with the therapist in the loop.

The control cycle is a process of its own, which this service starts and watches; this service may stall or be
killed, and the robot stands. Nothing here is a safety-rated function, and no driver of a physical humanoid
exists.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.control.limit_link import LimitLink
from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.serving.service import create_app
from handover_humanoid.metrics import REJECTED
from handover_humanoid.recording.recordings import Keep, Recordings
from handover_humanoid.recording.store import RecordingStore
from handover_humanoid.routes.humanoid_routes import add_humanoid_routes
from handover_humanoid.routes.input_socket import add_input_socket
from handover_humanoid.routes.recording_routes import add_recording_routes
from handover_humanoid.routes.session_routes import add_session_routes
from handover_humanoid.running.device import HumanoidDevice
from handover_humanoid.running.device_tasks import HumanoidTasks
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.ros_link import RosLink
from handover_humanoid.running.sessions.signals import PatientSignals
from handover_humanoid.running.sessions.store import SessionStore
from handover_humanoid.running.sessions.training import Training
from handover_humanoid.running.sessions.writer import SessionWriter
from handover_humanoid.running.store import Store
from handover_humanoid.settings import WholeBodySettings


def make_app(settings: WholeBodySettings) -> FastAPI:
    """Return the application; raise `UsageError` for a humanoid that does not exist."""
    engine = connect(settings.database("whole-body-control"))
    store = Store(engine)
    guard = Guard(settings, "whole-body-control")
    broker = BrokerClient(settings, credentials=guard.access)
    tasks = BackgroundTasks("whole-body control")
    writer = reporting_writer("whole-body-control", settings, broker, REJECTED)
    limits = LimitLink(
        settings.human_state,
        settings.humanoid_name,
        headers=guard.access.headers,
        ca_files=settings.ca_files,
        required=settings.humanoid_required_limits,
    )
    signals = PatientSignals()
    control = HumanoidControl(settings, store, limits)
    sessions = SessionStore(engine)
    training = Training(control, sessions, signals)
    session_writer = SessionWriter(training, sessions)
    control.links.on_tick = training.tick
    performer = HumanoidTasks(settings, control, training, session_writer, broker)
    device = HumanoidDevice(settings, control, broker, writer)

    recordings = Recordings(
        settings.humanoid_name,
        settings.ports_folder,
        Keep(
            settings.recordings_folder,
            settings.humanoid_recording_days,
            settings.humanoid_recordings_mb * 2**20,
            settings.humanoid_recording_minutes * 60,
            settings.humanoid_recording_hz,
        ),
        RecordingStore(engine),
        control.document,
    )

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        for prepare in (store.prepare, sessions.prepare, recordings.prepare, control.open):
            await asyncio.to_thread(prepare)
        try:
            async with broker, writer, tasks:
                for work in (
                    control.process.watch,
                    control.links.run,
                    limits.run,
                    control.keep_stops,
                    device.run,
                    session_writer.run,
                    recordings.run,
                ):
                    tasks.start_restarting(work)
                if settings.humanoid_ros_link:
                    tasks.start_restarting(RosLink(settings, control, guard.access).run)
                await performer.act_for(device.id)
                control.links.may_command = performer.leases.of(device.id).is_held
                async with performer:
                    yield
                await session_writer.flush()
        finally:
            await recordings.close()
            control.throws.close()
            await control.rehearsals.close()
            await control.process.stop()
            engine.dispose()

    app = create_app(
        "Whole-body control",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"broker": broker.probe, "subscription": performer.probe},
        guard=guard,
        audit=AuditTrail(settings, "whole-body-control", engine),
    )
    add_humanoid_routes(app, control)
    add_input_socket(app, control, signals)
    add_session_routes(app, training, session_writer)
    add_recording_routes(app, recordings)
    performer.mount(app)
    return app
