"""A control cycle in this process, without pauses, with MuJoCo as its robot."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handover_humanoid.components.robot import RobotSensors
from handover_humanoid.control_process import control_loop
from handover_humanoid.cycle.deployment import Deployment
from handover_humanoid.cycle.ports import PortWriter
from handover_humanoid.cycle.wish import PERSON, WISH


class Cycle:
    """The cycle of a deployment whose component `walking` has these parameters, and who commands it."""

    def __init__(self, folder: Path, **walking: Any) -> None:
        components = {
            "robot": {"kind": "mujoco", "realtime": True},
            "walking": {"kind": "walking", "realtime": True, **walking},
        }
        deployment = Deployment.model_validate(
            {"folder": folder, "paced": False, "fifo": False, "components": components}
        )
        self.loop, self._state = control_loop(deployment)
        self._wish, self._person = PortWriter(folder / "wish", WISH), PortWriter(folder / "person", PERSON)

    def run(
        self, seconds: float, wish: Mapping[str, float], person: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Run with a wish and the hands of a person; return the state."""
        wanted = np.array([wish.get(name, 0.0) for name in WISH])
        done = np.array([(person or {}).get(name, 0.0) for name in PERSON])
        for _ in range(round(seconds / self.loop.robot.period_s)):
            self._wish.write(wanted)
            self._person.write(done)
            self.loop.cycle()
        assert self._state.read()
        return dict(zip(self._state.names, self._state.values.tolist(), strict=True))

    def spoil(self, change: Callable[[RobotSensors], None]) -> None:
        """Change what the robot measures from now on."""
        read = self.loop.robot.read

        def spoiled(sensors: RobotSensors) -> None:
            read(sensors)
            change(sensors)

        self.loop.robot.read = spoiled  # type: ignore[method-assign]
