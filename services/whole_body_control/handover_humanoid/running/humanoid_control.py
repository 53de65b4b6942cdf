"""The humanoid of this service: its model, the control cycle, what people want of it, and its limits."""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

from sqlalchemy.exc import SQLAlchemyError

from handover.control.limit_link import LimitLink
from handover.control.speed_limits import Allowed
from handover.errors import Problem
from handover.messages import message
from handover.security.caller import Caller
from handover.telemetry import get_logger
from handover_humanoid.behaviours.component_state import Behaviour, Fault
from handover_humanoid.behaviours.humanoid_component import behaviours_of
from handover_humanoid.behaviours.rehearsal import FILE as REHEARSALS
from handover_humanoid.behaviours.throwing import Practice
from handover_humanoid.behaviours.walking import footsteps_of
from handover_humanoid.cycle.loop import HoldReason, Mode
from handover_humanoid.metrics import FRACTION
from handover_humanoid.robots import folder, humanoid
from handover_humanoid.running.cycle_process import CycleProcess
from handover_humanoid.running.gains import ChainGains, Shares
from handover_humanoid.running.inputs import PersonInputs, PoseMessage, PullMessage, Turns
from handover_humanoid.running.live import LiveDocument
from handover_humanoid.running.motion import NAMES, Motion
from handover_humanoid.running.port_links import PortLinks
from handover_humanoid.running.rehearsals import Rehearsals
from handover_humanoid.running.store import Store
from handover_humanoid.running.throws import Throws
from handover_humanoid.settings import WholeBodySettings

log = get_logger(__name__)

KEEP_AGAIN_S: Final = 1.0
"""Pause before a stop is stored again that could not be stored."""

FAULTS: Final[Mapping[int, str]] = {
    Fault.SENSORS: message("humanoid.fault_sensors", "a sensor has no valid value; the last command holds"),
    Fault.SOLVER: message("humanoid.fault_solver", "the motion of this cycle could not be computed"),
    Fault.PULLED_HARD: message(
        "humanoid.fault_pulled", "a hand was pulled too hard and has opened; let it go, and take it again"
    ),
    Fault.FALLEN: message(
        "humanoid.fault_fallen", "the robot has fallen; restart the control cycle to put it on its feet"
    ),
    Fault.THROW_REFUSED: message(
        "humanoid.fault_throw", "the control cycle refused the throw: the arm cannot do it"
    ),
    Fault.NOT_OFFERED: message(
        "humanoid.fault_not_offered",
        "this robot does not offer the behaviour: juggling and assisted walking are for simulated robots",
    ),
    Fault.STRETCHED: message(
        "humanoid.fault_stretched",
        "the legs are stretched in the pose stand, so the robot does not walk; bend the knees in its SRDF",
    ),
    Fault.RELAXED: message(
        "humanoid.fault_relaxed",
        "limits, contacts and tasks contradict each other; a constraint was relaxed as little as possible",
    ),
}
HOLDS: Final[Mapping[int, str]] = {
    HoldReason.FAULTS: message(
        "humanoid.hold_faults", "no valid values for too long; the joints hold. Restart the control cycle"
    ),
    HoldReason.FAILED: message(
        "humanoid.hold_failed",
        "the controller failed, and the joints hold; the log of the control cycle says why. Restart it",
    ),
    HoldReason.REFUSED: message(
        "humanoid.hold_refused",
        "the robot refused a command, and the joints hold; the log of the control cycle says why. Restart it",
    ),
}

STANDING = 0.0


class HumanoidControl:
    """The humanoid; `run` keeps its ports. Not thread-safe."""

    def __init__(self, settings: WholeBodySettings, store: Store, limits: LimitLink) -> None:
        self.name = settings.humanoid_name
        self.model = humanoid(settings.model_name)
        self.offered = behaviours_of(self.model)
        self.process = CycleProcess(settings)
        self.motion = Motion(footsteps_of(self.model))
        self.limits = limits
        self.inputs = PersonInputs()
        self.steering = Turns()
        """Who has the dead-man control: a therapist at the page, or a node of a ROS graph."""
        self.gains = ChainGains(self.model)
        self.links = PortLinks(self.process, self._wish, self.inputs.port_values, self.gains.port_values)
        self.live = LiveDocument(self.name, self.model.joint_names, self.motion, self.inputs)
        self.live.shown.faults, self.live.shown.holds = FAULTS, HOLDS
        practice = Practice()
        self.rehearsals = Rehearsals(
            self.model,
            practice,
            [
                folder(settings.model_name) / REHEARSALS,
                settings.rehearsals_folder / f"{self.model.name}.json",
            ],
        )
        self.throws = Throws(self.model, self.motion, practice, self.rehearsals, lambda: self.links.values)
        self._store = store
        self._has_unkept_stop = asyncio.Event()

    def open(self) -> None:
        """Find or start the control cycle; a stop that was not reset, and chosen gains, stay in force."""
        self.gains.restore(self._store.gains_of(self.name))
        self.motion.stopped = self._store.stop_of(self.name)
        self.rehearsals.open()
        self.process.open()

    def document(self) -> dict[str, Any]:
        """Return the live document of now."""
        self.links.refresh()
        self.live.shown.throw = self.throws.view()
        return self.live.of(self.links.values, self.problem)

    @property
    def is_down(self) -> bool:
        """Whether the joints hold for good, after a fault or a fall."""
        return self.links.values.get("mode") in {Mode.HOLDING, Mode.DOWN}

    async def restart(self) -> None:
        """Start the control cycle again: one that has ended, or whose robot holds for good.

        Raises `Problem` 409 while it runs.
        """
        if self.is_down and self.process.is_running:
            await self.process.stop(is_final=True)
        self.process.start()

    @property
    def problem(self) -> tuple[str, str] | None:
        """The code and the message of why the state is not live, None while it is."""
        if self.process.problem:
            return "cycleEnded", self.process.problem
        if self.links.is_live:
            return None
        if not self.links.values:
            return "cycleStarts", message("humanoid.cycle_starts", "the control cycle starts")
        return "cycleSilent", message(
            "humanoid.cycle_silent", "the control cycle is silent; it may have stalled"
        )

    @property
    def is_standing(self) -> bool:
        """Whether the robot stands on both feet and takes no step."""
        return self.links.values.get("phase") == STANDING

    async def stop(self, caller: Caller, reason: str) -> None:
        """Finish the step, and stand on both feet until a reset; it acts before it is stored."""
        stopped = self.motion.stop(caller.name, reason)
        log.warning("humanoid stopped", by=caller.name, reason=reason)
        try:
            await asyncio.to_thread(self._store.keep_stop, self.name, stopped)
        except SQLAlchemyError as error:
            log.warning("the stop is not stored yet", reason=str(error).splitlines()[0])
            self._has_unkept_stop.set()

    async def keep_stops(self) -> None:
        """Store a stop that could not be stored when it was made, until cancelled."""
        while True:
            await self._has_unkept_stop.wait()
            await asyncio.sleep(KEEP_AGAIN_S)
            with suppress(SQLAlchemyError):
                await asyncio.to_thread(self._store.keep_stop, self.name, self.motion.stopped)
                self._has_unkept_stop.clear()

    async def reset(self) -> None:
        """Release the stop, and those of limits. Raises `Problem` 409 while a limit still stops the robot."""
        still = self.limits.limits.reset(time.monotonic())
        self.update_limit()
        if still:
            raise Problem.translated(
                409,
                "Still stopped",
                "humanoid.still_limited",
                "the limit of {source} still stops the humanoid; reset it at human state first",
                source=still[0],
            )
        await asyncio.to_thread(self._store.keep_stop, self.name, None)
        self.motion.reset()

    def choose(self, behaviour: str) -> None:
        """Choose what the robot does; only while it stands on both feet. Raises `Problem` 409."""
        wanted = Behaviour(NAMES[behaviour])
        if wanted is self.motion.behaviour and not self.motion.is_finishing:
            return
        if not self.links.is_live or not self.is_standing:
            raise Problem.translated(
                409,
                "Not standing",
                "humanoid.not_standing",
                "the behaviour changes only while the humanoid stands on both feet; let it stand first",
            )
        if wanted is Behaviour.ASSISTED_WALKING and wanted not in self.offered:
            raise Problem.translated(
                501,
                "Cannot be led",
                "humanoid.cannot_be_led",
                "this humanoid cannot be led by the hands: its model needs the grips left_hand and "
                "right_hand, and knees that are bent in the pose stand",
            )
        if wanted is Behaviour.JUGGLING and not self.model.grips:
            raise Problem.translated(
                501,
                "Cannot juggle",
                "humanoid.no_grips",
                "no hand of this humanoid holds a ball; add grips to its model",
            )
        self.motion.begin(wanted)
        if wanted is Behaviour.JUGGLING:
            self.rehearsals.begin()

    async def change_gains(self, wanted: Mapping[str, Shares]) -> None:
        """Change the gains of chains, and store them. Raises `Problem` 422."""
        await self._keep_gains(self.gains.changed(wanted))

    async def reset_gains(self) -> None:
        """Return to the gains of the model."""
        await self._keep_gains(self.gains.defaults())

    async def _keep_gains(self, gains: Mapping[str, Shares]) -> None:
        await asyncio.to_thread(self._store.keep_gains, self.name, gains)
        self.gains.by_chain = gains
        log.info("gains changed", humanoid=self.name)

    def receive(self, contact: PoseMessage | PullMessage) -> None:
        """Take what a person does, and pass it on at once: a hand that leads is not late by a period."""
        self.inputs.receive(contact)
        self.links.write_person()

    def update_limit(self) -> None:
        """Take the least limit of now; without a source the robot is not limited."""
        self.motion.limit = self.limits.allowed(time.monotonic()) or Allowed("body")
        FRACTION.set(self.motion.limit.fraction)

    def _wish(self, names: tuple[str, ...]) -> list[float]:
        self.update_limit()
        self.inputs.values = self.links.values
        self.throws.tick()
        self.inputs.feel()
        return self.motion.values(names)
