"""Run the orchestrator: `python -m handover_processes`."""

from handover.serving.server import run
from handover_processes.app import make_only_app
from handover_processes.settings import OrchestratorSettings

if __name__ == "__main__":
    run("task-orchestrator", make_only_app, OrchestratorSettings, port_field="orchestrator_port")
