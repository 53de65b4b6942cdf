"""REST interface: its routes are in the folder `routes`, a module a subject."""

from fastapi import FastAPI

from handover.security.audit_trail import AuditTrail, Way
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover.telemetry import get_logger
from handover_processes.routes.definitions import add_definitions
from handover_processes.routes.device_leases import add_device_leases
from handover_processes.routes.event_log import add_event_log
from handover_processes.routes.events import add_events
from handover_processes.routes.forms import add_forms
from handover_processes.routes.interventions import add_pausing, add_repairs
from handover_processes.routes.mapping import add_mapping
from handover_processes.routes.migration import add_migration
from handover_processes.routes.offers import add_offers
from handover_processes.routes.processes import add_processes
from handover_processes.routes.statistics import add_statistics
from handover_processes.routes.tasklist import add_tasklist
from handover_processes.running.components import Components
from handover_processes.settings import OrchestratorSettings

log = get_logger(__name__)


def make_only_app(settings: OrchestratorSettings) -> FastAPI:
    """Return the application; wait as a standby while another orchestrator writes the database."""
    at = Components(settings)
    lock = at.orchestrator.store.lock
    if not lock.acquire():
        log.info("standby: another orchestrator writes the database; this one takes over when that one ends")
        lock.wait()
    return _app(at)


def make_app(settings: OrchestratorSettings) -> FastAPI:
    """Return the application; its lifespan opens the connections."""
    return _app(Components(settings))


def _app(at: Components) -> FastAPI:
    settings = at.settings
    app = create_app(
        "Task orchestrator",
        description="Runs BPMN processes: each activity becomes a Task for a person or a robot.",
        lifespan=at.lifespan,
        checks={
            "database": at.check_database,
            "broker": at.broker.probe,
            "subscription": at.reconciler.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=at.guard,
        audit=AuditTrail(
            settings, "task-orchestrator", at.orchestrator.store.engine, usual_way=Way.WITH_CHANGE
        ),
    )
    add_definitions(app, at.orchestrator)
    add_processes(app, at)
    add_pausing(app, at)
    add_migration(app, at)
    add_repairs(app, at)
    add_tasklist(app, at)
    add_forms(app, at)
    add_mapping(app, at.orchestrator)
    add_events(app, at)
    add_offers(app, at)
    add_statistics(app, at)
    add_event_log(app, at)
    add_device_leases(app, at)
    return app
