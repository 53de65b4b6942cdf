"""Definitions: their versions, and what is withheld from them."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum


@dataclass(frozen=True, slots=True)
class DefinitionRecord:
    """A deployed version of a BPMN file; versions of a name count from 1."""

    name: str
    version: int
    digest: str
    title: str
    label: str | None
    xml: bytes
    deployed_at: datetime
    source: str | None = None
    """The ProcessDefinition of another system that it was deployed from."""
    is_event_driven: bool = True
    """Whether its start events and filters of entities are needed at start-up; else it is read when used."""


class HoldKind(StrEnum):
    """What is withheld from a definition."""

    PAUSED = "paused"
    """Its timer start events wait."""
    SUSPENDED = "suspended"
    """No process of it starts, by whatever means."""
    DELETED = "deleted"
    """Likewise, and it is not listed; processes of it that have ended can be read."""


EVERY_DEFINITION = "*"
"""The name under which all definitions are paused."""


@dataclass(frozen=True, slots=True)
class DefinitionHold:
    """That a definition is paused, suspended or deleted, with the person who has decided it."""

    definition: str
    kind: HoldKind
    by: str
    why: str | None
    at: datetime
    verified: bool = False


@dataclass(frozen=True, slots=True)
class DeletedVersion:
    """That a version of a definition is deleted: nothing starts it; processes of it can be read."""

    definition: str
    version: int
    by: str
    why: str | None
    at: datetime
    verified: bool = False
