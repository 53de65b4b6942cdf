"""What may be asked of a session: by Tasks and over REST, as plans."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, FiniteFloat, model_validator
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover.settings import Settings
from handover_humanoid.running.sessions.training import SessionPlan
from handover_humanoid.sessions.difficulty import CatchingSpace, DifficultyRules
from handover_humanoid.sessions.exercise import Goal

Side = Literal["left", "right"]
Name = Annotated[str, Field(pattern=r"^(urn:ngsi-ld:Person:)?[A-Za-z0-9_.:-]{1,128}$")]
Place = tuple[
    Annotated[FiniteFloat, Field(ge=0.2, le=2.0)],
    Annotated[FiniteFloat, Field(ge=-1.0, le=1.0)],
    Annotated[FiniteFloat, Field(ge=0.0, le=2.0)],
]
Count = Annotated[int, Field(ge=1, le=1000)]
Seconds = Annotated[FiniteFloat, Field(gt=0, le=3600)]


class _Parameters(StrictModel):
    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)

    person: Name | None = None


class JuggleParameters(_Parameters):
    """Throw so many balls at a person; `target` in m fixes where they land: ahead, to the left, up."""

    throws: Count = 10
    catches: Count | None = None
    seconds: Seconds | None = None
    hand: Side | None = None
    target: Place | None = None
    start_level: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.1
    is_adaptive: bool = True
    weak_side: Side | None = None
    needs_grip: bool = False


class WalkParameters(_Parameters):
    """Walk with a person who leads by the hands, for so many seconds of exercise."""

    seconds: Seconds = 60.0


class GoalRequest(StrictModel):
    """What ends a session; the first one that is reached."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    throws: Count | None = None
    catches: Count | None = None
    seconds: Seconds | None = None

    @model_validator(mode="after")
    def _has_one(self) -> "GoalRequest":
        if self.throws is None and self.catches is None and self.seconds is None:
            raise ValueError("a goal has throws, catches or seconds")
        return self


class SessionRequest(_Parameters):
    """A session: its application, who exercises, its goal, and how difficult it is."""

    application: Literal["juggling", "walking"]
    goal: GoalRequest
    hand: Side | None = None
    target: Place | None = None
    start_level: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.1
    is_adaptive: bool = True
    weak_side: Side | None = None
    needs_grip: bool = False


def plan_of(
    asked: JuggleParameters | WalkParameters | SessionRequest, settings: Settings, task: str | None = None
) -> SessionPlan:
    """Return the plan of what was asked."""
    person = None if asked.person is None else settings.entity_id("Person", asked.person)
    if isinstance(asked, WalkParameters):
        return SessionPlan("walking", Goal(seconds=asked.seconds), person, task)
    rules = DifficultyRules(
        start=asked.start_level, is_adaptive=asked.is_adaptive, weak_side=asked.weak_side, hand=asked.hand
    )
    space = CatchingSpace()
    if asked.target is not None:
        space = CatchingSpace(centre=asked.target, side_m=0.0, height_m=0.0)
    if isinstance(asked, SessionRequest):
        goal, application = asked.goal, asked.application
        return SessionPlan(
            application,
            Goal(goal.throws, goal.catches, goal.seconds),
            person,
            task,
            rules,
            space,
            asked.needs_grip,
        )
    goal_of_task = Goal(asked.throws, asked.catches, asked.seconds)
    return SessionPlan("juggling", goal_of_task, person, task, rules, space, asked.needs_grip)
