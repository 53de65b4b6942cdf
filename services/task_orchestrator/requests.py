"""The request bodies of the REST interface."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

MAX_PARAMETERS_BYTES = 1024 * 1024
"""Bytes of a body with parameters or variables."""
MAX_VERSION = 2**31 - 1


class ProcessStart(BaseModel):
    """A request to start a process."""

    model_config = ConfigDict(extra="forbid")

    definition: str = Field(description="the name of a deployed definition")
    version: int | None = Field(None, description="a version of it; the latest if absent")
    parameters: dict[str, Any] = Field(default_factory=dict, description="its parameters")
    key: str | None = Field(
        None, pattern=r"^[^\x00]{1,200}$", description="a second request with the same key starts no process"
    )


Name = Annotated[str, Field(pattern=r"^[^\x00]*[^\x00\s][^\x00]*$", max_length=200)]


class CancelRequest(BaseModel):
    """A request to cancel a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(None, description="the person who cancels it")


class RetryRequest(BaseModel):
    """A request to retry a failed Task."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who retries it")


class MendRequest(BaseModel):
    """What a person decides about a token of a process."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; nobody verifies the name yet")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that are set before")


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


class OfferRequest(BaseModel):
    """A decision about an offer."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the engineer who decides; nobody verifies the name yet")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class PauseRequest(BaseModel):
    """A request to pause or resume processes."""

    model_config = ConfigDict(extra="forbid")

    by: Name = Field(description="the person who decides; nobody verifies the name yet")
    why: str | None = Field(None, max_length=1000, description="the reason, for the history")


class MessageRequest(BaseModel):
    """A message to a process."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN message")
    key: str | int | float | bool | None = Field(
        None, description="the correlation key, or the business key of the process"
    )
    process: str | None = Field(None, description="the id of the process that gets it")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")
    ttl: str | None = Field(
        None, description="how long it is kept while no process waits for it, such as PT10M; PT0S: not at all"
    )


class SignalRequest(BaseModel):
    """A signal to all processes."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1, max_length=200, description="the name of the BPMN signal")
    variables: dict[str, Any] = Field(default_factory=dict, description="variables that it brings")


class MoveRequest(MendRequest):
    """A request to move a token."""

    to: str = Field(max_length=1000, description="the id of the element of the same scope to move it to")
