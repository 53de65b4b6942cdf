"""The gesture controller: REST and WebSocket for screens and programs, TCP for gloves."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.runtime.ports import require_free
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.security.protection import require_protection
from handover.service_addresses import GESTURE_CONTROLLER
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover.telemetry import get_logger
from handover_gloves.accuracy_tests.accuracy_test_runner import AccuracyTestRunner
from handover_gloves.accuracy_tests.store import AccuracyTestStore
from handover_gloves.calibration.calibration_session import CalibrationSessions
from handover_gloves.configuration import gestures_file
from handover_gloves.connection.glove_server import GloveServer
from handover_gloves.controller import GestureController
from handover_gloves.people.station_joins import StationJoins
from handover_gloves.routes.accuracy_tests import add_accuracy_tests
from handover_gloves.routes.calibration import add_calibration, add_fits
from handover_gloves.routes.gestures import add_gestures
from handover_gloves.routes.gloves import add_actions, add_gloves, add_streams
from handover_gloves.routes.own_gestures import add_own_gestures
from handover_gloves.routes.people import add_people
from handover_gloves.routes.people_views import PeopleParts
from handover_gloves.routes.pictures import add_pictures
from handover_gloves.routes.profiles import add_profiles
from handover_gloves.routes.study_conditions import add_study_conditions
from handover_gloves.settings import ControllerSettings

log = get_logger(__name__)


def make_app(settings: ControllerSettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    require_protection(settings, settings.glove_host, "HANDOVER_GLOVE_HOST")
    require_free(settings.glove_host, settings.glove_port, "HANDOVER_GLOVE_PORT", say=log.warning)
    guard = Guard(settings, GESTURE_CONTROLLER)
    broker = BrokerClient(settings, credentials=guard.access)
    site = gestures_file.load(settings.gestures_file)
    for restriction in site.restricted_answers():
        log.warning("some Tasks do not offer an answer by gesture", reason=restriction)
    joins = StationJoins(guard)
    controller = GestureController(settings, site, broker, joins)
    if not settings.is_local and settings.token is None:
        log.warning(
            "gloves need their own tokens",
            host=settings.glove_host,
            remedy="handover glove token NAME, or set HANDOVER_GLOVE_TOKEN for all",
        )
    registry, gestures = controller.registry, controller.configuration.gestures
    accuracy_tests = AccuracyTestRunner(AccuracyTestStore(controller.database), registry.known, gestures)
    calibrations = CalibrationSessions(registry.known, registry.fits, controller.calibrations)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with broker, controller, accuracy_tests, GloveServer(settings, registry):
            yield

    app = create_app(
        "Gesture controller",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "tasks": controller.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, GESTURE_CONTROLLER, controller.database),
    )
    controller.mount(app)
    add_gestures(app, controller)
    add_pictures(app, gestures)
    add_gloves(app, registry)
    people = PeopleParts(registry.wearers, registry.known, registry.records)
    add_people(app, people)
    add_own_gestures(app, people)
    add_profiles(app, people)
    add_calibration(app, calibrations, registry.known)
    add_fits(app, registry)
    add_actions(app, registry.known, guard)
    add_streams(app, registry.known)
    add_accuracy_tests(app, accuracy_tests, registry.known)
    add_study_conditions(app, registry.wearers)
    return app
