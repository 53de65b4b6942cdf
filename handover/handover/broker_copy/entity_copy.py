"""Copies the entities of a tenant, and compares both sides."""

from typing import Any, Final

import orjson

from handover.broker_copy.broker_side import BrokerSide
from handover.broker_copy.entity_form import Json, differences
from handover.broker_copy.report import MAX_LISTED, TenantReport

PROGRESS_EVERY: Final = 1000
MAX_SHOWN: Final = 120
"""Characters of a value in a message."""
KIND: Final = "entity"


class EntityCopy:
    """The copy of all entities from `source` to `target`."""

    def __init__(
        self, source: BrokerSide, target: BrokerSide, report: TenantReport, *, overwrites: bool
    ) -> None:
        self._source, self._target, self._report = source, target, report
        self._overwrites = overwrites
        self._refused: dict[str, str] = {}

    async def copy(self) -> None:
        """Create what the target does not have; replace what it has otherwise, if that is wanted."""
        counts = self._report.entities
        async for page in self._source.entities():
            present = await self._target.lookup(page)
            new = [entity for entity in page if entity["id"] not in present]
            others = [
                (entity, present[entity["id"]])
                for entity in page
                if entity["id"] in present and any(differences(entity, present[entity["id"]]))
            ]
            refused = await self._target.create(new) if new else {}
            counts.created += len(new) - len(refused)
            counts.present += len(page) - len(new) - len(others)
            if self._overwrites and others:
                refused_changes = await self._target.replace(others)
                counts.replaced += len(others) - len(refused_changes)
                refused |= refused_changes
            if len(self._refused) < MAX_LISTED:
                self._refused |= refused
            before = counts.found
            counts.found += len(page)
            if before // PROGRESS_EVERY < counts.found // PROGRESS_EVERY:
                self._report.say(f"  {counts.found} entities of {self._source.expected or 'many'}")
        self._require_complete()

    async def compare(self) -> None:
        """Read every entity from both brokers, and report what the target has not or has otherwise."""
        counts = self._report.entities
        async for page in self._source.entities():
            present = await self._target.lookup(page)
            for entity in page:
                target = present.get(entity["id"])
                if target is None:  # a query by type does not find an entity of other types
                    target = await self._target.retrieve(entity["id"])
                if self._compare(entity, target):
                    counts.equal += 1
        self._require_complete()
        if self._source.listed != counts.found:
            self._report.problem(
                "source",
                self._source.place.url,
                f"{counts.found} entities were read for the copy and {self._source.listed} for the "
                "comparison: they change; stop what writes them and give the command again",
            )
        await self._find_others(self._source.listed)

    def _compare(self, entity: Json, target: Json | None) -> bool:
        name = entity["id"]
        reason = self._refused.get(name)
        if target is None:
            why = f"not copied: {reason}" if reason else "not in the target"
            self._report.problem(KIND, name, why, reason=reason)
            return False
        is_equal = True
        for difference in differences(entity, target):
            is_equal = False
            self._report.problem(
                KIND,
                name,
                f"{difference.member}: {_shown(difference.source)} in the source, "
                f"{_shown(difference.target)} in the target" + (f" ({reason})" if reason else ""),
                attribute=difference.member,
                source=difference.source,
                target=difference.target,
            )
        return is_equal

    def _require_complete(self) -> None:
        """Report a list that ended before the number that the broker had counted."""
        if missed := self._source.missed:
            self._report.problem(
                "source",
                self._source.place.url,
                f"listed {missed} entities less than it had counted: they are deleted meanwhile, or its "
                "database was away; give the command again",
            )

    async def _find_others(self, listed: int) -> None:
        """Report entities of the target that the source does not have."""
        if (total := await self._target.count()) is not None and total <= listed:
            return
        async for page in self._target.entities():
            stored = await self._source.lookup(page)
            for entity in page:
                if entity["id"] not in stored and await self._source.retrieve(entity["id"]) is None:
                    self._report.problem(KIND, entity["id"], "only in the target", isOnlyInTarget=True)


def _shown(value: Any) -> str:
    if value is None:
        return "absent"
    text = orjson.dumps(value).decode()
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"
