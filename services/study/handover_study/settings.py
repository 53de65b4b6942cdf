"""The settings of the study service, in addition to the common ones."""

from handover.extensions import Service
from handover.service_addresses import STUDY, ControllerAddress, StudyAddress
from handover.settings import Settings


class StudySettings(StudyAddress, ControllerAddress, Settings):
    """The address of the service, and that of the gesture controller."""


SERVICE = Service(STUDY, "handover_study", StudySettings, "study_port")
