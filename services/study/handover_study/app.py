"""The study service: usability studies of the gestures, with questionnaires, conditions and analysis."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.broker.resync import Resync
from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service_addresses import STUDY
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_study.routes.studies import add_study
from handover_study.sessions.controller_client import ControllerClient
from handover_study.sessions.gesture_conditions import GestureConditions
from handover_study.sessions.study_session import StudySessions
from handover_study.settings import StudySettings
from handover_study.storage.store import StudyStore

RECONCILE_INTERVAL_S = 2.0


def make_app(settings: StudySettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    database = connect(settings.database("study"))
    guard = Guard(settings, STUDY)
    client = ControllerClient(settings.gesture_controller, guard.access, settings.ca_files)
    conditions = GestureConditions(client)
    sessions = StudySessions(StudyStore(database), conditions)
    resync = Resync(conditions.reconcile, RECONCILE_INTERVAL_S)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with client, sessions, BackgroundTasks("study") as tasks:
            tasks.start(resync.run)
            yield
        database.dispose()

    app = create_app(
        "Study",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"storage": storage_check(settings.data_dir)},
        guard=guard,
        audit=AuditTrail(settings, STUDY, database),
    )
    add_study(app, sessions)
    return app
