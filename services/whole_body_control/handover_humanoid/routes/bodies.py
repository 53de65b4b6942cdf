"""The bodies of requests and answers."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover_datamodels.robot_messages import Vector

Reason = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S")]


class Body(StrictModel):
    """A JSON object in camelCase without unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class StopRequest(Body):
    """Why the robot is stopped."""

    reason: Reason = "stopped by a person"


class ThrowRequest(Body):
    """A throw of a hand to a target in m: x ahead of the feet, y to the left, z up."""

    target: Vector
    hand: Literal["left", "right"] = "right"


class ThrowView(Body):
    """The number of the throw that was asked for, and whether the hand rehearses before it."""

    number: int
    is_preparing: bool


class BehaviourRequest(Body):
    """What the robot is to do."""

    behaviour: Literal["walking", "assistedWalking", "juggling"]


Share = Annotated[FiniteFloat, Field(gt=0, le=100)]


class GainShares(Body):
    """Shares of the gains of the model: 1 is that of the model."""

    stiffness: Share = 1.0
    damping: Share = 1.0


class GainsRequest(Body):
    """Gains of chains; chains that are not named keep theirs."""

    chains: dict[str, GainShares]


class ChainGainsView(Body):
    """The gains of a chain: the shares that were chosen, their limits, and the joints that have them."""

    chain: str
    joints: list[str]
    stiffness: float
    damping: float
    stiffness_limits: tuple[float, float]
    damping_limits: tuple[float, float]


class HumanoidView(Body):
    """A model that is installed; one of them runs. There is no driver of a physical humanoid."""

    model: str
    name: str | None
    is_running: bool
    joints: int
    mass_kg: float
    hands: list[str]
    behaviours: list[str]
    drivers: list[str]
    problem: str


class LimitSourceView(Body):
    """A source of speed limits: the fraction that it allows now, and why."""

    source: str
    fraction: float
    reason: str
    needs_reset: bool


class StateView(Body):
    """Whether the robot is stopped, and whether its control cycle runs."""

    is_stopped: bool
    is_running: bool
    problem: str
    starts: int
    pid: int | None


class ModelView(Body):
    """The model of a humanoid: chains, sensors, contacts, the stacks of tasks, and default poses."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str
    joints: list[str]
    chains: list[dict[str, Any]]
