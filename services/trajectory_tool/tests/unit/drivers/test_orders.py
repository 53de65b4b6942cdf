"""Orders for robots that others move: which Tasks of a shared broker are these orders."""

import re

import pytest

from handover.broker import BrokerClient
from handover.settings import Settings
from handover_robots.drivers.orders import Orders


def orders(cell: str, robot: str) -> Orders:
    settings = Settings.load(_env_file=None, factory=cell)
    return Orders(robot, settings.entity_id("Device", robot), settings, BrokerClient(settings))


@pytest.mark.parametrize(
    ("cell", "robot"),
    [
        ("line-1", "arm.1"),
        ("line.1", "arm-1"),
        ("line.1.2", "arm.1"),
        ("line", "arm.1"),
        ("line.1", "arm.11"),
    ],
)
def test_orders_of_other_cells_and_robots_are_not_these(cell: str, robot: str) -> None:
    """Those of an earlier run are cancelled at the start."""
    own, other = orders("line.1", "arm.1"), orders(cell, robot)
    assert re.search(own.id_pattern, f"{own.prefix}0123456789ab")
    assert not re.search(own.id_pattern, f"{other.prefix}0123456789ab")
