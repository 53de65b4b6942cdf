"""Components: the orchestrator and what keeps it consistent with the broker, from start to end."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.security.guard import Guard
from handover.telemetry import get_logger
from handover_bpmn.forms.form_js import BadForm
from handover_bpmn.notation.faults import BadBpmn
from handover_processes.allocation.mapping import read_mapping_file
from handover_processes.running.archive import Archiver
from handover_processes.running.definition_offers import DefinitionOffers
from handover_processes.running.entity_events import EntityEvents
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.running.reconcile import Reconciler
from handover_processes.settings import OrchestratorSettings

log = get_logger(__name__)

SHIPPED = Path(__file__).parents[1] / "processes"


class Components:
    """The components of the service; the routes share them."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self.settings = settings
        self.guard = Guard(settings, "task-orchestrator")
        self.broker = BrokerClient(settings, credentials=self.guard.access)
        self.orchestrator = Orchestrator(settings, self.broker)
        self.reconciler = Reconciler(self.orchestrator, self.broker)
        self.archiver = Archiver(self.orchestrator, self.broker)
        self.entity_events = EntityEvents(self.orchestrator, self.broker)
        self.offers = DefinitionOffers(self.orchestrator, self.broker, self.reconciler)

    def plain_id(self, process_id: str) -> str:
        """Return the id of a process, which may be given as its URN."""
        return process_id.removeprefix(self.settings.entity_id("Process", ""))

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Deploy the definitions of the folders and run until the service ends."""
        async with self.broker, self.orchestrator:
            if self.settings.mapping_file is not None:
                await self._load_mapping(self.settings.mapping_file)
            await self._deploy_folder(SHIPPED)
            if self.settings.process_dir is not None:
                await self._deploy_folder(self.settings.process_dir)
            async with self.reconciler, self.archiver, self.entity_events, self.offers:
                yield

    async def _load_mapping(self, file: Path) -> None:
        """Store the mapping of a file if there is none yet."""
        if self.orchestrator.state.allocator.rules.mapping.version:
            return
        try:
            read = read_mapping_file(await asyncio.to_thread(file.read_text, encoding="utf-8"))
        except (OSError, UnicodeDecodeError, UsageError) as error:
            log.warning("mapping file not read", file=str(file), error=str(error))
            return
        await self.orchestrator.deployments.set_mapping(read.entries, by=read.by, why=read.why)
        log.info("mapping stored", file=str(file), entries=len(read.entries), confirmed_by=read.by)

    async def _deploy_folder(self, folder: Path) -> None:
        if not await asyncio.to_thread(folder.is_dir):
            log.warning("folder of BPMN files not found", folder=str(folder))
        for file in await asyncio.to_thread(lambda: sorted(folder.glob("*.form"))):
            await self._deploy_form(file)
        for file in await asyncio.to_thread(lambda: sorted(folder.glob("*.bpmn"))):
            try:
                xml = await asyncio.to_thread(file.read_bytes)
                deployed = await self.orchestrator.deployments.deploy(xml, only_if_never_seen=True)
            except BadBpmn as bad:
                faults = [str(fault) for fault in bad.faults]
                log.warning("BPMN file not deployed", file=str(file), faults=faults)
            except OSError as error:
                log.warning("BPMN file not readable", file=str(file), error=str(error))
            else:
                for deployment in deployed.deployments:
                    log.info("definition deployed", name=deployment.name, version=deployment.version)

    async def _deploy_form(self, file: Path) -> None:
        try:
            content = await asyncio.to_thread(file.read_bytes)
            deployed = await self.orchestrator.deployments.deploy_files([], [(file.name, content)])
        except (BadForm, OSError) as error:
            log.warning("form not deployed", file=str(file), error=str(error))
        else:
            record = deployed.forms[0].record
            log.info("form deployed", form=record.id, version=record.version)

    async def check_database(self) -> None:
        """Raise an exception if the database does not answer."""
        await self.orchestrator.on_disk(self.orchestrator.store.probe)
