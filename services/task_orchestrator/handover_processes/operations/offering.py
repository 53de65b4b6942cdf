"""Offering: definitions of other systems are offered to engineers, who accept or reject them."""

import asyncio
from collections.abc import Collection, Iterable, Sequence
from typing import cast

from handover.errors import Problem
from handover_bpmn.notation.comparison import changed_elements
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import BpmnFile, read_bpmn
from handover_processes.allocation.report import allocation_report
from handover_processes.definitions.offer_rules import Candidate
from handover_processes.documents.definitions import ActivityAllocation
from handover_processes.documents.offers import OfferView, changed_attributes, element_change_view, offer_view
from handover_processes.operations.deployments import deploy_into
from handover_processes.records.offers import Decision, OfferRecord, OfferStatus
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState

MAX_PARSED = 32
"""Files of offers that are kept in parsed form."""


class Offering:
    """Changes of offers."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer
        self._parsed: dict[str, BpmnFile] = {}

    async def receive(self, candidates: Sequence[Candidate], gone: Collection[str] = ()) -> None:
        """Offer the present contents of entities; close the offers of entities that are `gone`."""
        deployed = [await self._is_deployed(candidate) for candidate in candidates]

        def act(step: Step) -> None:
            now = self._state.clock()
            for entity in gone:
                self._state.offers.withdraw(step, entity)
            for candidate, is_deployed in zip(candidates, deployed, strict=True):
                self._state.offers.receive(step, candidate, now, is_deployed=is_deployed)

        if candidates or gone:
            await self._writer.apply(act)

    async def accept(self, offer: str, *, by: str, why: str | None) -> OfferRecord:
        """Deploy what is offered, or put it in force, in one transaction with the decision.

        Raises `Problem` 404 if there is no such offer, 409 if it is closed, 422 if it has faults.
        """
        record = self.require(offer)
        if record.faults:
            raise BadBpmn(list(record.faults), record.warnings)
        file = None if record.type != "ProcessDefinition" else await self.read_file(record)

        def act(step: Step) -> OfferRecord:
            present = self._require_open(step, offer, (OfferStatus.OPEN, OfferStatus.REJECTED))
            deployed: tuple[tuple[str, int], ...] = ()
            if file is not None:
                results = deploy_into(step, self._state, file, source=present.entity)
                deployed = tuple((deployment.name, deployment.version) for deployment in results.deployments)
            decision = Decision(
                self._state.clock(), OfferStatus.ACCEPTED, by, why, deployed, step.is_verified(by)
            )
            return self._state.offers.decide(step, offer, decision)

        return await self._writer.apply(act)

    async def reject(self, offer: str, *, by: str, why: str | None) -> OfferRecord:
        """Reject an offer; raises `Problem` 404 if there is no such offer, 409 if it is closed."""
        self.require(offer)

        def act(step: Step) -> OfferRecord:
            self._require_open(step, offer, (OfferStatus.OPEN,))
            decision = Decision(
                self._state.clock(), OfferStatus.REJECTED, by, why, verified=step.is_verified(by)
            )
            return self._state.offers.decide(step, offer, decision)

        return await self._writer.apply(act)

    def require(self, offer: str) -> OfferRecord:
        """Return an offer; raise `Problem` 404 if there is none."""
        record = self._state.offers.find(offer)
        if record is None:
            raise Problem.translated(
                404, "No such offer", "offer.unknown", 'there is no offer "{offer}"', offer=offer
            )
        return record

    async def read_file(self, record: OfferRecord) -> BpmnFile:
        """Return the parsed file of an offer; raise `BadBpmn` if this release cannot read it."""
        if record.id not in self._parsed:
            xml: bytes | None = await self._state.on_disk(self._state.store.offer_file, record.id)
            read = await asyncio.to_thread(read_bpmn, xml or b"")
            while len(self._parsed) >= MAX_PARSED:
                del self._parsed[next(iter(self._parsed))]
            self._parsed[record.id] = read
        return self._parsed[record.id]

    def _require_open(self, step: Step, offer: str, allowed: Iterable[OfferStatus]) -> OfferRecord:
        record = self._state.offers.present(step, offer)
        if record is None or record.status not in allowed:
            status = "deleted" if record is None else record.status.value
            raise Problem.translated(
                409,
                "Offer is closed",
                "offer.closed",
                "the offer is {status}; look at the present offer of the entity",
                status=status,
            )
        return record

    async def _is_deployed(self, candidate: Candidate) -> bool:
        """Return whether all processes of a file are deployed already, each as the latest version."""
        if candidate.file is None or candidate.faults:
            return False
        read = await asyncio.to_thread(read_bpmn, candidate.file)
        registry, now = self._state.registry, self._state.clock()
        return not any(registry.next_version(definition, (), now)[1] for definition in read.definitions)


class OfferReader:
    """What people see of offers: what an acceptance would deploy and change, and who would get the work."""

    def __init__(self, state: WorkingState, offering: Offering) -> None:
        self._state = state
        self._offering = offering

    async def view(self, record: OfferRecord) -> OfferView:
        """Return an offer with all details."""
        view = offer_view(record)
        if record.status is not OfferStatus.OPEN:
            return view
        if record.type != "ProcessDefinition":
            accepted = self._state.offers.in_force(record.entity)
            view["changes"] = changed_attributes(None if accepted is None else accepted, record)
            return view
        if record.faults or not record.has_file:
            return view
        registry, now = self._state.registry, self._state.clock()
        for definition in (await self._offering.read_file(record)).definitions:
            new, is_created = registry.next_version(definition, (), now)
            view["definitions"].append(
                {"name": new.name, "version": new.version, "title": new.title, "created": is_created}
            )
            view["allocation"] += cast(
                "list[ActivityAllocation]",
                allocation_report(self._state.allocator.rules, self._state.allocator.forms, definition),
            )
            if is_created and new.version > 1:
                before = registry.record(new.name, new.version - 1).xml
                changes = await asyncio.to_thread(changed_elements, before, definition.xml, new.name)
                view["changes"] += [element_change_view(change) for change in changes]
        return view
