"""Numbers of the same kind, put into classes by size, with next to no effort.

A histogram of the usual kind locks and looks up at each number, which the shortest requests and commits would
notice. A tally belongs to one thread, and is put in order when somebody reads it.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate

from prometheus_client.core import HistogramMetricFamily, Metric
from prometheus_client.registry import REGISTRY, Collector, CollectorRegistry


class Tally:
    """How many numbers there were up to each of `bounds`, and what they come to."""

    __slots__ = ("bounds", "counts", "total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def note(self, number: float) -> None:
        """Count one number."""
        self.counts[bisect_left(self.bounds, number)] += 1
        self.total += number

    def add(self, other: "Tally") -> None:
        """Count what another tally with the same bounds has counted."""
        self.counts = [one + more for one, more in zip(self.counts, other.counts, strict=True)]
        self.total += other.total

    def buckets(self) -> list[tuple[str, float]]:
        """Return each bound and how many numbers were up to it, as Prometheus wants them."""
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
        """Return what there will be, without numbers."""
        return (HistogramMetricFamily(self._name, self._about),)

    def collect(self) -> Iterator[Metric]:
        """Yield the numbers as they are."""
        yield HistogramMetricFamily(
            self._name, self._about, buckets=self.tally.buckets(), sum_value=self.tally.total
        )
