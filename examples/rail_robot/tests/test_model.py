"""The rail arm keeps what every robot model keeps."""

from handover_robots.model_contract import ModelContract


class TestRail(ModelContract):
    """The tests of the contract."""

    robot = "rail"
