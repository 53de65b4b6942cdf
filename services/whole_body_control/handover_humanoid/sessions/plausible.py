"""What a tracked person cannot have done: hands that jump or leave the room, forces of a person who falls.

A headset that finds its place again shifts everything at once. Such a pose would let a hand that holds the
robot pull at it, or meet a ball, so after a jump the tracking counts as lost for `SETTLE_S`. Places are in m
on the ground of the robot, times in s of one clock; forces in N.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

Problem = Literal["jump", "far", "force"]

MAX_AWAY_M: Final = 5.0
"""From the robot: the room in which a ball counts (`CatchRules.room_m`)."""
MAX_HAND_MPS: Final = 15.0
MAX_HEAD_MPS: Final = 5.0
JUMP_M: Final = 0.3
"""A shorter way is no jump, however late a message was."""
SETTLE_S: Final = 0.5
MAX_FORCE_N: Final = 150.0
RELEASE_S: Final = 1.0
"""How long the hands stay let go after a force beyond the limit."""
HEAD: Final = "head"

Point = Sequence[float]


class Plausibility:
    """Watches the places of head and hands, and the forces of the hands. Not thread-safe."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[float, Point]] = {}
        self._until_s: dict[Problem, float] = {}

    def see(self, now_s: float, places: Mapping[str, Point], robot: Point, *, is_moved: bool = False) -> None:
        """Take the places that are tracked now, by name; `robot` (2,) is where it stands.

        `is_moved` says that the person recentred the view: the new places are compared with none.
        """
        for name, place in places.items():
            before = self._places.get(name)
            if before is not None and not is_moved and _is_jump(name, now_s - before[0], before[1], place):
                self._note("jump", now_s + SETTLE_S)
            if (
                math.hypot(place[0] - robot[0], place[1] - robot[1]) > MAX_AWAY_M
                or abs(place[2]) > MAX_AWAY_M
            ):
                self._note("far", now_s + SETTLE_S)
        self._places = {name: (now_s, place) for name, place in places.items()}

    def feel(self, now_s: float, forces: Sequence[Point]) -> None:
        """Take the forces of a person on the hands of the robot (3,)."""
        for force in forces:
            if math.hypot(*force) > MAX_FORCE_N:
                self._note("force", now_s + RELEASE_S)

    def problem(self, now_s: float) -> Problem | None:
        """Return what is wrong now, the worst first."""
        order: tuple[Problem, ...] = ("force", "far", "jump")
        return next((reason for reason in order if self._until_s.get(reason, -math.inf) > now_s), None)

    def _note(self, problem: Problem, until_s: float) -> None:
        self._until_s[problem] = until_s


def _is_jump(name: str, dt_s: float, before: Point, place: Point) -> bool:
    way_m = math.dist(before, place)
    fastest_mps = MAX_HEAD_MPS if name == HEAD else MAX_HAND_MPS
    return way_m > JUMP_M and way_m > fastest_mps * max(dt_s, 0.0)
