"""Mapping: the table from the names in process files to performers.

Files of other tools name lanes, groups, topics and classes, and no resources of the factory. An entry of the
table maps such a name to a resource, a role or required skills. Only a version of the table that a person has
confirmed gives work to robots and devices.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from handover.errors import UsageError
from handover.formats.strict_json import StrictModel
from handover.formats.validation import fault_lines
from handover_bpmn.references import is_reference

MAX_ENTRIES = 10_000

Text = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=300)]


class NameKind(StrEnum):
    """The kinds of names that an entry can map; the first that matches an activity decides."""

    DEFINITION = "definition"
    CLASS = "class"
    TOPIC = "topic"
    JOB_TYPE = "jobType"
    ASSIGNEE = "assignee"
    CANDIDATE_GROUP = "candidateGroup"
    LANE = "lane"


class MappingEntry(StrictModel):
    """A name in process files, and who performs the activities with it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: NameKind = Field(description="what the name is in the file")
    name: Text = Field(description="the name as it stands in the file")
    resource: Text | None = Field(None, description="the performer, such as Device:ur10-1, or a URN")
    role: Text | None = Field(None, description="the role that the performer has")
    skills: tuple[Text, ...] | None = Field(
        None, min_length=1, max_length=50, description="the skills that the performer has"
    )
    definition: str | None = Field(
        None, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}$", description="the TaskDefinition of its Tasks"
    )
    parameters: dict[str, Any] = Field(
        default_factory=dict, max_length=100, description="parameters of its Tasks; they replace others"
    )

    @model_validator(mode="after")
    def _has_one_performer(self) -> "MappingEntry":
        performers = [
            performer for performer in (self.resource, self.role, self.skills) if performer is not None
        ]
        if len(performers) != 1:
            raise ValueError(f'the entry for {self.kind} "{self.name}" has one of resource, role and skills')
        if self.resource is not None and not is_reference(self.resource):
            raise ValueError(f'"{self.resource}" names no entity; write Type:id such as Device:ur10-1')
        return self


class MappingRequest(StrictModel):
    """A new version of the mapping; it replaces all entries."""

    model_config = ConfigDict(extra="forbid")

    by: Text = Field(
        max_length=200,
        description="the person who confirms it; with accounts the name of the account is stored",
    )
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")
    version: int | None = Field(None, ge=0, description="the version that it replaces: 409 if it is another")
    entries: tuple[MappingEntry, ...] = Field(max_length=MAX_ENTRIES)

    @model_validator(mode="after")
    def _has_distinct_names(self) -> "MappingRequest":
        _check_distinct(self.entries)
        return self


class MappingFile(BaseModel):
    """The mapping of the first start; without `by` it gives no work to robots and devices."""

    model_config = ConfigDict(extra="forbid")

    by: Text | None = None
    why: str | None = Field(None, max_length=1000)
    entries: tuple[MappingEntry, ...] = Field(max_length=MAX_ENTRIES)

    @model_validator(mode="after")
    def _has_distinct_names(self) -> "MappingFile":
        _check_distinct(self.entries)
        return self


@dataclass(frozen=True)
class MappingTable:
    """A version of the mapping; version 0 is empty."""

    version: int = 0
    entries: tuple[MappingEntry, ...] = ()
    by: str | None = None
    """The person who confirmed it; None if nobody did."""
    why: str | None = None
    at: datetime | None = None
    verified: bool = False
    """Whether `by` is the name of who was signed in."""

    def find(self, names: Iterable[tuple[NameKind, str]]) -> MappingEntry | None:
        """Return the entry of the first of `names` that has one."""
        return next((self._index[name] for name in names if name in self._index), None)

    @cached_property
    def _index(self) -> Mapping[tuple[NameKind, str], MappingEntry]:
        return {(entry.kind, entry.name): entry for entry in self.entries}


def read_mapping_file(text: str) -> MappingFile:
    """Return the mapping of a YAML file; raise `UsageError` that names the entry and the rule."""
    try:
        return MappingFile.model_validate(yaml.safe_load(text))
    except yaml.YAMLError as error:
        raise UsageError(f"the mapping is no YAML: {error}") from None
    except ValidationError as error:
        raise UsageError("; ".join(fault_lines(error, "mapping"))) from None


def _check_distinct(entries: Iterable[MappingEntry]) -> None:
    seen: set[tuple[NameKind, str]] = set()
    for entry in entries:
        if (entry.kind, entry.name) in seen:
            raise ValueError(f'{entry.kind} "{entry.name}" has two entries; keep one')
        seen.add((entry.kind, entry.name))
