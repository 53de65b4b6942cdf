"""Run the study service: `python -m handover_study`."""

from handover.service_addresses import STUDY
from handover.serving.server import run
from handover_study.app import make_app
from handover_study.settings import StudySettings

if __name__ == "__main__":
    run(STUDY, make_app, StudySettings, port_field="study_port")
