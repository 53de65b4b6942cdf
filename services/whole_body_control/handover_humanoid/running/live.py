"""The live document: what the page and the headset draw, from the state of the control cycle."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from handover.messages import with_code
from handover_humanoid.patterns.regions import SIDES
from handover_humanoid.running.inputs import PersonInputs
from handover_humanoid.running.motion import Motion

MODES: Final = ("following", "standing", "holding", "stopped", "down")
PHASES: Final = ("standing", "double", "single")
BEHAVIOURS: Final = ("walking", "assistedWalking", "juggling")
CAUSES: Final = ("computing", "preempted", "woken late")
RESIDUAL, SLACK, SOLVER, GAIN = "residual.", "slack.", "solver_us.", "gain."
BALL_PHASES: Final = (None, "held", "flying", "landed", "lost")
_PLACES: Final = 5


@dataclass
class Shown:
    """What the document says beside the state of the cycle, set by the parts of the service."""

    session: Mapping[str, Any] | None = None
    ball_phase: str | None = None
    """"caught" or "missed", from the catch detection of a session."""
    throw: Mapping[str, Any] | None = None
    fault: Mapping[str, Any] | None = None
    faults: Mapping[int, str] = field(default_factory=dict)
    holds: Mapping[int, str] = field(default_factory=dict)
    """Why the joints hold for good, where no fault says it."""


class LiveDocument:
    """Makes documents for one humanoid with these joints."""

    def __init__(self, humanoid: str, joints: Sequence[str], motion: Motion, inputs: PersonInputs) -> None:
        self._humanoid, self._motion, self._inputs = humanoid, motion, inputs
        self._joints = tuple(f"joint.{name}" for name in joints)
        self.shown = Shown()

    def of(self, values: Mapping[str, float], problem: tuple[str, str] | None) -> dict[str, Any]:
        """Return the document of the state `values`; without them, of a robot of which nothing is known.

        `problem` is the code and the message of why the state is not live.
        """
        motion, shown = self._motion, self.shown
        stopped, limit = motion.stopped, motion.limit
        mode = _name(MODES, values.get("mode"))
        is_still = mode in {"following", "standing"} and values.get("phase") == 0.0
        fault = _fault(values, shown)
        if problem is not None:
            fault = {"code": problem[0], **with_code("message", problem[1])}
        return {
            "t": _round(values.get("robot_time_s")),
            "sentAt": time.time(),
            "humanoid": self._humanoid,
            "mode": "stopped" if is_still and stopped is not None else mode,
            "behaviour": self._behaviour(values),
            "phase": _name(PHASES, values.get("phase")),
            "base": _vector(values, "base", ("x", "y", "z", "qx", "qy", "qz", "qw")),
            "joints": [_round(values.get(name)) for name in self._joints] if values else [],
            "com": _vector(values, "com", "xy"),
            "comReference": _vector(values, "reference", "xy"),
            "zmp": _vector(values, "measured_zmp", "xy"),
            "zmpReference": _vector(values, "wanted_zmp", "xy"),
            "velocityReference": _vector(values, "velocity_reference", "xy"),
            "stance": _vector(values, "feet", ("x", "y", "yaw")),
            "feet": {side: _foot(values, side) for side in SIDES},
            "hands": {side: _hand(values, side) for side in SIDES},
            "throw": shown.throw,
            "ball": self._ball(values),
            "stack": _stack(values),
            "relaxed": _relaxed(values),
            "solver": _solver(values),
            "cycle": _cycle(values),
            "gains": _gains(values),
            "limit": {
                "factor": round(limit.fraction, 4),
                "rule": limit.rule,
                **with_code("reason", limit.reason),
                "needsReset": limit.needs_reset,
            },
            "stop": {
                "isStopped": stopped is not None,
                "by": stopped.by if stopped else "",
                "reason": stopped.reason if stopped else "",
            },
            "needsRelease": motion.needs_release,
            "patient": self._inputs.shown(time.monotonic()),
            "session": shown.session,
            "fault": fault,
        }

    def _behaviour(self, values: Mapping[str, float]) -> str:
        """Return what it does: walking without a wish is standing."""
        code = values.get("behaviour", float(self._motion.behaviour))
        name = _name(BEHAVIOURS, code) or "walking"
        return "standing" if name == "walking" and values.get("phase", 0.0) == 0.0 else name

    def _ball(self, values: Mapping[str, float]) -> dict[str, Any] | None:
        phase = self.shown.ball_phase or _name(BALL_PHASES, values.get("ball_phase"))
        if phase is None:
            return None
        return {
            "position": _vector(values, "ball", "xyz"),
            "phase": phase,
            "target": _vector(values, "target", "xyz"),
            "landing": _vector(values, "ball_landed", "xyz"),
        }


def _fault(values: Mapping[str, float], shown: Shown) -> Mapping[str, Any] | None:
    code = _count(values, "fault")
    if code:
        return {"code": f"fault{code}", **with_code("message", shown.faults.get(code, ""))}
    hold = _count(values, "hold")
    if hold:
        return {"code": f"hold{hold}", **with_code("message", shown.holds.get(hold, ""))}
    return shown.fault


def _foot(values: Mapping[str, float], side: str) -> dict[str, Any]:
    return {
        "force": _vector(values, f"{side}_foot.force", "xyz"),
        "pressure": _vector(values, f"{side}_foot.pressure", "xy"),
        "share": _round(values.get(f"support_{side}")),
        "landing": _vector(values, f"{side}_landing", ("x", "y", "yaw")),
    }


def _hand(values: Mapping[str, float], side: str) -> dict[str, Any]:
    return {
        "force": _vector(values, f"{side}_hand.force", "xyz"),
        "manipulability": _round(values.get(f"{side}_hand.manipulability")),
    }


def _stack(values: Mapping[str, float]) -> list[dict[str, Any]]:
    rows = []
    for name, value in values.items():
        if name.startswith(RESIDUAL) and math.isfinite(value):
            level, _, task = name.removeprefix(RESIDUAL).partition(".")
            rows.append({"level": int(level), "task": task, "residual": _round(value)})
    return rows


def _relaxed(values: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the constraints that were relaxed in the last seconds, with their largest slack."""
    return [
        {"constraint": name.removeprefix(SLACK), "slack": _round(value)}
        for name, value in values.items()
        if name.startswith(SLACK) and math.isfinite(value) and value > 0
    ]


def _solver(values: Mapping[str, float]) -> dict[str, Any]:
    """Return the histogram of the solver's times: upper bound in microseconds (null is above all), count."""
    histogram = []
    for name in values:
        if name.startswith(SOLVER):
            bound = name.removeprefix(SOLVER)
            histogram.append((None if bound == "inf" else int(bound), _count(values, name)))
    return {
        "medianUs": _quantile(histogram, 0.5),
        "p99Us": _quantile(histogram, 0.99),
        "histogram": histogram,
    }


def _quantile(histogram: Sequence[tuple[int | None, int]], share: float) -> int | None:
    """Return the upper bound of the bucket of a quantile, None without counts or above all bounds."""
    wanted = share * sum(count for _, count in histogram)
    seen = 0
    for bound, count in histogram:
        seen += count
        if count and seen >= wanted:
            return bound
    return None


def _cycle(values: Mapping[str, float]) -> dict[str, Any]:
    counts = {cause: values.get(f"late: {cause}", 0.0) for cause in CAUSES}
    return {
        "count": _count(values, "cycles"),
        "late": _count(values, "late"),
        "lost": _count(values, "lost"),
        "cause": max(counts, key=lambda cause: counts[cause]) if any(counts.values()) else "",
    }


def _gains(values: Mapping[str, float]) -> dict[str, dict[str, float | None]]:
    """Return the shares of the gains of the model that the joints have now, by chain."""
    by_chain: dict[str, dict[str, float | None]] = {}
    for name, value in values.items():
        if name.startswith(GAIN):
            chain, _, kind = name.removeprefix(GAIN).rpartition(".")
            by_chain.setdefault(chain, {})[kind] = _round(value)
    return by_chain


def _count(values: Mapping[str, float], name: str) -> int:
    value = values.get(name, 0.0)
    return int(value) if math.isfinite(value) else 0


def _name(names: Sequence[Any], code: float | None) -> Any:
    is_known = code is not None and math.isfinite(code) and 0 <= int(code) < len(names)
    return names[int(code)] if is_known and code is not None else None


def _vector(values: Mapping[str, float], name: str, axes: Sequence[str]) -> list[float] | None:
    """Return a vector, None if a value is missing or not finite."""
    coordinates = [values.get(f"{name}.{axis}", math.nan) for axis in axes]
    return (
        [round(coordinate, _PLACES) for coordinate in coordinates]
        if all(map(math.isfinite, coordinates))
        else None
    )


def _round(value: float | None) -> float | None:
    return round(value, _PLACES) if value is not None and math.isfinite(value) else None
