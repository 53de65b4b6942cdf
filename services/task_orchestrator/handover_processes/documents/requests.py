"""The request bodies of the REST interface."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from handover.formats.strict_json import StrictModel
from handover.formats.validation import Moment
from handover.security.proofs.pin_check import MAX_PIN_CHARACTERS
from handover_datamodels.entities import TaskStatus
from handover_datamodels.states import Outcome
from handover_processes.storage.process_filter import ProcessFilter, read_condition

MAX_PARAMETERS_BYTES = 1024 * 1024
"""Bytes of a body with parameters or variables."""
MAX_VERSION = 2**31 - 1


DefinitionVersion = Annotated[int | None, Field(ge=1, le=MAX_VERSION)]
"""The number of a version, where it may be left out."""
Plain = Annotated[str, Field(pattern=r"^[^\x00]*$", max_length=300)]


class ProcessStart(StrictModel):
    """A request to start a process."""

    model_config = ConfigDict(extra="forbid")

    definition: str = Field(description="the name of a deployed definition")
    version: DefinitionVersion = Field(None, description="a version of it; the latest if absent")
    parameters: dict[str, Any] = Field(default_factory=dict, description="its parameters")
    key: str | None = Field(
        None,
        pattern=r"^[^\x00]{1,200}$",
        description="the business key, which people see; the same key never starts a second process",
    )
    request: str | None = Field(
        None,
        pattern=r"^[0-9a-f]{12}$",
        description="a random number of the request, which nobody sees; the end of the id of the process, so "
        "that the same request sent again starts no second one",
    )


class ProcessQuery(BaseModel):
    """The filter of a list of processes."""

    model_config = ConfigDict(extra="forbid")

    status: TaskStatus | None = None
    definition: Plain | None = None
    version: DefinitionVersion = None
    key: Plain | None = Field(None, description="the business key")
    search: Plain | None = Field(
        None, description="a part of the business key, of the id or of the title, or the number"
    )
    involves: Plain | None = Field(None, description="the URN of a person or resource that a Task involves")
    variable: list[str] = Field(
        default_factory=list,
        max_length=8,
        description="a condition on a variable: total>=100, order.customer=Acme, name~part, or a name",
    )
    started_since: Moment | None = Field(None, alias="startedSince")
    started_until: Moment | None = Field(None, alias="startedUntil")
    ended_since: Moment | None = Field(None, alias="endedSince")
    ended_until: Moment | None = Field(None, alias="endedUntil")
    incident: bool | None = Field(None, description="whether it has an open incident")
    unallocated: bool | None = Field(None, description="whether an activity waits for a performer")
    element: Plain | None = Field(
        None, description="an element at which it waits or, with incident=true, has an incident"
    )

    def read(self) -> ProcessFilter:
        """Return the filter; raise `Problem` 422 for a bad condition on a variable."""
        return ProcessFilter(
            status=None if self.status is None else self.status.value,
            definition=self.definition,
            version=self.version,
            key=self.key,
            search=self.search,
            resource=self.involves,
            variables=[read_condition(condition) for condition in self.variable],
            started_since=self.started_since,
            started_until=self.started_until,
            ended_since=self.ended_since,
            ended_until=self.ended_until,
            has_incident=self.incident,
            is_unallocated=self.unallocated,
            element=self.element,
        )


class ProcessListQuery(ProcessQuery):
    """A page of a list of processes."""

    before: Plain | None = Field(None, description="the id of a process: return those started before it")
    limit: int = Field(100, ge=1, le=1000)


class TaskListQuery(BaseModel):
    """A page of the list of Tasks that people have open."""

    model_config = ConfigDict(extra="forbid")

    claimed_by: Plain | None = Field(None, description="claimed by this person")
    assignee: Plain | None = Field(
        None, description="claimed by this person, or given or offered to them by name"
    )
    group: Plain | None = Field(None, description="offered to this group")
    process: Plain | None = Field(None, description="of this process")
    definition: Plain | None = Field(None, description="of processes of this definition")
    search: Plain | None = Field(
        None,
        description="a part of the name, of its id or element, or of the name or business key of its process",
    )
    before: Plain | None = Field(None, description="the id of a Task: return those listed after it")
    limit: int = Field(1000, ge=1, le=5000)


class EventLogQuery(ProcessQuery):
    """The processes of an event log."""

    format: Literal["xes", "csv"] = "xes"
    limit: int = Field(1000, ge=1, le=1000, description="processes, the latest first")


class TableQuery(BaseModel):
    """The form of a table."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["json", "csv"] = "json"


class PeriodQuery(TableQuery):
    """The period of a report: whole hours, the last seven days by default, 366 days at most."""

    since: Moment | None = None
    until: Moment | None = None


class ScopedQuery(PeriodQuery):
    """The period of a report, and the definition that it is about."""

    definition: Plain | None = None
    version: DefinitionVersion = Field(None, description="all versions if absent")


class ElementsQuery(PeriodQuery):
    """The definition of a report about its elements, and the period."""

    definition: Plain
    version: DefinitionVersion = Field(None, description="all versions if absent")


class ThroughputQuery(ScopedQuery):
    """The definition, the period and the step of a report about throughput."""

    step: Literal["hour", "day"] | None = Field(
        None, description="hour for up to 92 days, or day (UTC); by default hour for up to 7 days"
    )


class IncidentsQuery(TableQuery):
    """The definition of a report about open incidents."""

    definition: Plain | None = None
    version: DefinitionVersion = Field(None, description="all versions if absent")


Name = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=200)]


class CancelRequest(StrictModel):
    """A request to cancel a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(None, description="the person who cancels it")


class RetryRequest(StrictModel):
    """A request to retry a failed Task."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who retries it")


class MendRequest(StrictModel):
    """What a person decides about a token of a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; with accounts the name of the account is stored")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that are set before")


class VariablesRequest(MendRequest):
    """Variables that a person sets."""

    scope: str | None = Field(
        None, max_length=20, description="one of the `scopes` of the process; the process itself if absent"
    )


class MigrationRequest(MendRequest):
    """A request to migrate a process to another version of its definition."""

    version: int | None = Field(
        None, ge=1, le=MAX_VERSION, description="the version to continue in; the latest if absent"
    )
    mapping: dict[str, str] = Field(
        default_factory=dict, description="elements that have another id in that version, by their present id"
    )


class MigrationOfAllRequest(MigrationRequest):
    """A request to migrate all running processes of a version."""

    source: int = Field(ge=1, le=MAX_VERSION, description="the version that the processes have")


class OfferRequest(StrictModel):
    """A decision about an offer."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the engineer who decides; with accounts the name of the account is stored")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class PauseRequest(StrictModel):
    """A request to pause or resume processes."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; with accounts the name of the account is stored")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class MessageRequest(StrictModel):
    """A message to a process."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN message")
    key: str | int | float | bool | None = Field(
        None, description="the correlation key, or the business key of the process"
    )
    process: str | None = Field(
        None, description="the id of the only process that gets it, now or once it waits for it"
    )
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")
    ttl: str | None = Field(
        None, description="how long it is kept while no process waits for it, such as PT10M; PT0S: not at all"
    )


class SignalRequest(StrictModel):
    """A signal to all processes."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN signal")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")


class MoveRequest(MendRequest):
    """A request to move a token."""

    to: str = Field(max_length=1000, description="the id of the element of the same scope to move it to")


Text = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=2000)]


class ClaimRequest(StrictModel):
    """The person who claims a Task; with accounts the name of the account counts."""

    model_config = ConfigDict(extra="forbid")

    by: Name
    groups: list[Name] = Field(default_factory=list, max_length=100, description="the person's groups")
    override: bool = Field(False, description="whether to claim a Task that is offered to others")


class ReturnRequest(StrictModel):
    """The person who returns a Task."""

    model_config = ConfigDict(extra="forbid")

    by: Name
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class DeclineRequest(StrictModel):
    """The person who declines a Task, and why."""

    model_config = ConfigDict(extra="forbid")

    by: Name
    why: Text = Field(description="the reason, for the history and the next person")


class CompleteRequest(StrictModel):
    """The result of a Task that a person has claimed."""

    model_config = ConfigDict(extra="forbid")

    by: Name
    outcome: Outcome = Outcome.OK
    note: str = Field("", max_length=1000)
    outputs: dict[str, Any] = Field(default_factory=dict, description="the result, as the form asks")
    pin: str | None = Field(
        None, max_length=MAX_PIN_CHARACTERS, description="the PIN, if the Task demands it"
    )


class CommentRequest(StrictModel):
    """A comment; a second request with the same `id` adds none."""

    model_config = ConfigDict(extra="forbid")

    by: Name
    text: Text
    id: str | None = Field(None, pattern=r"^[0-9a-f]{32}$")


class FormData(StrictModel):
    """The values typed so far."""

    model_config = ConfigDict(extra="forbid")

    values: dict[str, Any] = Field(default_factory=dict)


class DeployedFile(StrictModel):
    """A BPMN file or a form of form-js."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(pattern=r"^[^\x00/\\]{1,200}\.(bpmn|form)$", description="the name of the file")
    content: str


class DeploymentRequest(StrictModel):
    """Files that are deployed together: all or none."""

    model_config = ConfigDict(extra="forbid")

    files: list[DeployedFile] = Field(min_length=1, max_length=100)
