"""The rail arm keeps what every robot model keeps."""

from services.trajectory_tool.model_contract import ModelContract


class TestRail(ModelContract):
    """The tests of the contract."""

    robot = "rail"
