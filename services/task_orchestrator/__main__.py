"""Run the orchestrator: `python -m services.task_orchestrator`."""

from handover.serving import run
from services.task_orchestrator.app import make_only_app
from services.task_orchestrator.settings import OrchestratorSettings

if __name__ == "__main__":
    run("task-orchestrator", make_only_app, OrchestratorSettings, port_field="orchestrator_port")
