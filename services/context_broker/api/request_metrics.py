"""What was asked, how often, with what end, and how long it took, counted with next to no effort.

A counter and a histogram of the usual kind lock and look up at each request, which the shortest requests
would notice; these numbers are plain ones of the event loop, put in order when somebody reads them.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import accumulate
from typing import Final

from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import REGISTRY, Collector, CollectorRegistry

BOUNDS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.1, 0.5, 1.0, 5.0)


class _Tally:
    __slots__ = ("counts", "total_s")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)
        self.total_s = 0.0


class RequestMetrics(Collector):
    """The requests answered, by operation and status, and the seconds that they took, commit included."""

    def __init__(self, registry: CollectorRegistry = REGISTRY) -> None:
        self._tallies: dict[tuple[str, int], _Tally] = {}
        registry.register(self)

    def note(self, operation: str, status: int, seconds: float) -> None:
        """Count one request."""
        tally = self._tallies.get((operation, status))
        if tally is None:
            tally = self._tallies[operation, status] = _Tally()
        tally.counts[bisect_left(BOUNDS_S, seconds)] += 1
        tally.total_s += seconds

    def describe(self) -> Iterable[Metric]:
        """Return what there will be, without numbers."""
        return (_answered(), _took())

    def collect(self) -> Iterator[Metric]:
        """Yield the numbers as they are."""
        answered, took = _answered(), _took()
        together: dict[str, _Tally] = {}
        for (operation, status), tally in list(self._tallies.items()):
            answered.add_metric([operation, str(status)], sum(tally.counts))
            whole = together.setdefault(operation, _Tally())
            whole.counts = [one + more for one, more in zip(whole.counts, tally.counts, strict=True)]
            whole.total_s += tally.total_s
        bounds = [*map(str, BOUNDS_S), "+Inf"]
        for operation, whole in together.items():
            sums = [float(count) for count in accumulate(whole.counts)]
            took.add_metric([operation], list(zip(bounds, sums, strict=True)), whole.total_s)
        yield answered
        yield took


def _answered() -> CounterMetricFamily:
    return CounterMetricFamily(
        "handover_broker_requests", "Requests answered", labels=["operation", "status"]
    )


def _took() -> HistogramMetricFamily:
    return HistogramMetricFamily(
        "handover_broker_request_seconds",
        "From a request to its answer, commit included",
        labels=["operation"],
    )
