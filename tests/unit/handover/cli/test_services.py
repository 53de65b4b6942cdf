"""Which services a cell has, as it is set."""

import pytest

from handover.cli.services import SERVICES, service_named, wanted


def test_the_ros_bridge_belongs_to_a_cell_that_has_a_mapping_for_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.chdir(str(tmp_path))
    monkeypatch.delenv("HANDOVER_ROS_MAPPING", raising=False)
    monkeypatch.setattr("handover.cli.services.HUMAN_STATE_NEEDS", ("a_package_that_is_not_there",))
    assert wanted() == SERVICES
    monkeypatch.setenv("HANDOVER_ROS_MAPPING", "arm")
    assert wanted() == (*SERVICES, service_named("ros-bridge"))


def test_human_state_belongs_to_a_cell_where_its_extra_is_installed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.chdir(str(tmp_path))
    monkeypatch.delenv("HANDOVER_ROS_MAPPING", raising=False)
    monkeypatch.setattr("handover.cli.services.HUMAN_STATE_NEEDS", ("pydantic",))
    assert wanted() == (*SERVICES, service_named("human-state"))
