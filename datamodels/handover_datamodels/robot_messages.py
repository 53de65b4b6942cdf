"""What the streams of robots through the ROS bridge share: arms, humanoids and links of humanoids."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from handover_datamodels.streams import StreamMessage

Name = Annotated[str, Field(min_length=1, max_length=200)]
"""Of a joint, a topic or an action."""
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class StreamRefusal(StreamMessage):
    """Why the bridge does not follow a stream."""

    type: Literal["refused"] = "refused"
    reason: str
