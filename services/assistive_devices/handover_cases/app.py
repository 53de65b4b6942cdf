"""Assistive devices: machines that adapt to the body of a person, as simulated cases.

Nothing here is a medical device or a safety-rated function.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service_addresses import ASSISTIVE_DEVICES
from handover.serving.service import create_app
from handover.tasks.device_lease import DeviceLease, DeviceLeases
from handover.tasks.finished_tasks import FinishedTasks
from handover_cases.body_link import BodyLink
from handover_cases.machine import CASES, Case, MachineContext
from handover_cases.metrics import REJECTED
from handover_cases.routes.machines import add_routes
from handover_cases.running.entities import MachineRecords
from handover_cases.running.machine_runner import MachineRunner
from handover_cases.running.ros_commands import RosCommands
from handover_cases.settings import AssistiveSettings


def make_app(settings: AssistiveSettings) -> FastAPI:
    """Return the application; raise `UsageError` for a machine that does not exist."""
    engine = connect(settings.database("assistive-devices"))
    guard = Guard(settings, ASSISTIVE_DEVICES)
    broker = BrokerClient(settings, credentials=guard.access)
    tasks = BackgroundTasks("assistive devices")
    writer = reporting_writer(ASSISTIVE_DEVICES, settings, broker, REJECTED)
    runners: dict[str, MachineRunner] = {}
    for name in settings.assistive_machines:
        case: Case = CASES.load(name)
        link = BodyLink(
            settings.human_state,
            person=case.person,
            robot=case.robot,
            sensors=case.sensors,
            headers=guard.access.headers,
            ca_files=settings.ca_files,
        )
        runners[name] = MachineRunner(case, link, tasks)
        runners[name].machine.prepare(MachineContext(settings, engine))
    domain = settings.assistive_ros_domain
    identity = FinishedTasks(settings, ASSISTIVE_DEVICES)
    leases = DeviceLeases(settings, ASSISTIVE_DEVICES, guard.access.headers)

    def lease_of(runner: MachineRunner) -> DeviceLease:
        return leases.of(settings.entity_id("Device", runner.case.robot))

    commands = None if domain is None else RosCommands(domain, list(runners.values()), lease_of)
    records = MachineRecords(settings, list(runners.values()), broker, writer)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with broker, writer, tasks:
            for runner in runners.values():
                tasks.start_restarting(runner.link.run)
                tasks.start_restarting(runner.run)
                tasks.start_restarting(runner.machine.work)
            tasks.start_restarting(records.run)
            if commands is not None:
                await identity.open()
                holder, was_leased = await identity.identity()
                leases.open(holder, was_leased=was_leased, keep_mark=identity.mark_leased)
                tasks.start_restarting(leases.run)
                tasks.start_restarting(commands.run)
            yield
        if commands is not None:
            await leases.release()
            await identity.close()
        for runner in runners.values():
            runner.link.close()
        engine.dispose()

    app = create_app(
        "Assistive devices",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"broker": broker.probe},
        guard=guard,
        audit=AuditTrail(settings, ASSISTIVE_DEVICES, engine),
    )
    add_routes(app, runners)
    return app
