"""Run the study service: `python -m services.study`."""

from handover.serving import run
from services.study.app import make_app
from services.study.settings import StudySettings

if __name__ == "__main__":
    run("study", make_app, StudySettings, port_field="study_port")
