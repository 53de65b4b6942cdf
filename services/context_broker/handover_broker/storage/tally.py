"""Histograms that cost very little.

A Prometheus histogram locks and searches for each value, which is measurable for the shortest requests and
commits. A tally belongs to one thread, and is converted when it is read.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate

from prometheus_client.core import HistogramMetricFamily, Metric
from prometheus_client.registry import REGISTRY, Collector, CollectorRegistry


class Tally:
    """Counts of values by upper bounds, and their sum."""

    __slots__ = ("bounds", "counts", "total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def note(self, number: float) -> None:
        """Count a value."""
        self.counts[bisect_left(self.bounds, number)] += 1
        self.total += number

    def add(self, other: "Tally") -> None:
        """Add the counts of another tally with the same bounds."""
        self.counts = [count + more for count, more in zip(self.counts, other.counts, strict=True)]
        self.total += other.total

    def buckets(self) -> list[tuple[str, float]]:
        """Return each bound with the count of values up to it, as Prometheus expects."""
        bounds = [*(str(float(bound)) for bound in self.bounds), "+Inf"]
        return list(zip(bounds, map(float, accumulate(self.counts)), strict=True))


class TalliedMetric(Collector):
    """A histogram without labels, filled through `tally`."""

    def __init__(
        self, name: str, about: str, bounds: Sequence[float], registry: CollectorRegistry = REGISTRY
    ) -> None:
        self.tally = Tally(bounds)
        self._name = name
        self._about = about
        registry.register(self)

    def describe(self) -> Iterable[Metric]:
        """Return the metric without values."""
        return (HistogramMetricFamily(self._name, self._about),)

    def collect(self) -> Iterator[Metric]:
        """Yield the metric."""
        yield HistogramMetricFamily(
            self._name, self._about, buckets=self.tally.buckets(), sum_value=self.tally.total
        )
