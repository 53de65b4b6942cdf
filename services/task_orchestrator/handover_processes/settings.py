"""Settings of the task orchestrator."""

from pathlib import Path

from pydantic import Field

from handover.extensions import Service
from handover.service_addresses import ORCHESTRATOR
from handover.settings import MaybePath, Settings


class OrchestratorSettings(Settings):
    """The settings of the orchestrator, in addition to the common ones."""

    process_dir: Path | None = Field(None, description="a folder whose *.bpmn files are deployed at start")
    mapping_file: MaybePath = Field(
        None, description="a YAML file with the mapping from names to performers, read at the first start"
    )
    task_deadline_s: float = Field(
        300.0,
        gt=0,
        description="an Alert is raised for a Task of a device that is not accepted within this time; a "
        "deadline in the BPMN file replaces it, and applies to Tasks of people as well",
    )
    performer_grace_s: float = Field(
        30.0,
        ge=0,
        description="a Task in progress whose performer has lost the lease of its Device is treated as its "
        "definition says (onPerformerLost) when no performer has the lease again after this time",
    )
    cancel_grace_s: float = Field(
        5.0, ge=0, description="a cancelled Task that no performer has accepted is closed after this time"
    )
    message_ttl_s: float = Field(
        3600.0,
        ge=0,
        description="a message that no process waits for is kept for this time, unless its sender says "
        "otherwise",
    )
    resources_need_acceptance: bool = Field(
        False,
        description="a ResourceSpecification or Location of another system has no effect until an engineer "
        "accepts it; otherwise it has one until an engineer rejects it",
    )
    keep_days: float = Field(
        365.0,
        ge=0,
        description="an ended process is deleted from the database after so many days; 0: never",
    )


SERVICE = Service(ORCHESTRATOR, "handover_processes", OrchestratorSettings, "orchestrator_port")
