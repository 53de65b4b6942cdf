"""What a processor is: it turns samples of one signal of one sensor into features."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from handover_body.model.features import Feature
from handover_body.model.signals import Samples, SensorReport


class Processor(Protocol):
    """Streaming analysis of one signal of one sensor, pure: no clock, no input, no output.

    Memory is bounded by the longest window, whatever is fed.
    """

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take the next samples; return the features that they complete, oldest first."""
        ...

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Take a fault or lost contact: no later value may depend on samples before and after it."""
        ...


@runtime_checkable
class EventProcessor(Processor, Protocol):
    """A processor of events that has something to say while none comes."""

    def nothing_happened(self, source: str, until_s: float) -> Sequence[Feature]:
        """Take note that there was no event until `until_s`; return the features that this completes."""
        ...
