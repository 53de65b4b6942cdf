"""Metrics of requests: operation, status, duration."""

from collections.abc import Iterable, Iterator
from typing import Final

from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import REGISTRY, Collector, CollectorRegistry

from handover_broker.storage.tally import Tally

BOUNDS_S: Final = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.1, 0.5, 1.0, 5.0)


class RequestMetrics(Collector):
    """Counts responses by operation and status, and their duration, commit included."""

    def __init__(self, registry: CollectorRegistry = REGISTRY) -> None:
        self._tallies: dict[tuple[str, int], Tally] = {}
        registry.register(self)

    def note(self, operation: str, status: int, seconds: float) -> None:
        """Count one request."""
        tally = self._tallies.get((operation, status))
        if tally is None:
            tally = self._tallies[operation, status] = Tally(BOUNDS_S)
        tally.note(seconds)

    def describe(self) -> Iterable[Metric]:
        """Return the metrics without values."""
        return (_answered(), _took())

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics."""
        answered, took = _answered(), _took()
        together: dict[str, Tally] = {}
        for (operation, status), tally in list(self._tallies.items()):
            answered.add_metric([operation, str(status)], sum(tally.counts))
            together.setdefault(operation, Tally(BOUNDS_S)).add(tally)
        for operation, whole in together.items():
            took.add_metric([operation], whole.buckets(), whole.total)
        yield answered
        yield took


def _answered() -> CounterMetricFamily:
    return CounterMetricFamily(
        "handover_broker_requests", "Requests answered", labels=["operation", "status"]
    )


def _took() -> HistogramMetricFamily:
    return HistogramMetricFamily(
        "handover_broker_request_duration_seconds",
        "From a request to its answer, commit included",
        labels=["operation"],
    )
