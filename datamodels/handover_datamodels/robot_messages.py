"""What the streams of robots through the ROS bridge share: arms, humanoids and links of humanoids."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

Name = Annotated[str, Field(min_length=1, max_length=200)]
"""Of a joint, a topic or an action."""
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class RobotMessage(BaseModel):
    """One JSON text of a WebSocket of the bridge, in camelCase without unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class StreamRefusal(RobotMessage):
    """Why the bridge does not follow a stream."""

    type: Literal["refused"] = "refused"
    reason: str
