"""The settings of the study service, in addition to the common ones."""

from handover.extensions import Service
from handover.service_addresses import STUDY, ControllerAddress, StudyAddress


class StudySettings(StudyAddress, ControllerAddress):
    """The address of the service, and that of the gesture controller."""


SERVICE = Service(STUDY, "handover_study", StudySettings, "study_port")
