"""A simulated person with sensors, for machines that run on a clock of their own, faster than life.

    person = SensedPerson(driver, curve)
    person.body.walk(1.2)          # what the person does
    person.step()                  # one packet of every signal passes all checks, analyses, fusion and limits
    person.heart_rate, person.limit.fraction

Everything that a machine learns of the person comes from the samples: monitor of the driver,
pipeline of the signal, fusion, limit, as in the service. Only the clock is simulated: `now_s`,
in s since 1970.
"""

from collections.abc import Sequence
from typing import Final

from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.simulated.driver import SimulatedDriver
from handover_body.drivers.simulated.person import SimulatedPerson
from handover_body.fusion.person_state import FusedValue, PersonState
from handover_body.limits.body_limit import BodyLimit, HeartRate
from handover_body.limits.curve import LimitCurve
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import SignalInfo
from handover_body.monitoring.processors import pipeline_of
from handover_body.processing.pipeline import SignalPipeline

DEFAULT_START_S: Final = 1_700_000_000.0


class SensedPerson:
    """One person, one simulated driver with some signals, and the state and the limit that follow from them.

    The driver needs `pace` 0; a `start_s` in its settings makes runs repeatable.
    """

    def __init__(self, driver: SimulatedDriver, curve: LimitCurve) -> None:
        settings = driver.settings
        self.state: Final = PersonState()
        self.now_s: float = DEFAULT_START_S if settings.start_s is None else settings.start_s
        self.limit = BodyLimit(curve, self.now_s, self.now_s)
        self._driver: Final = driver
        kinds = frozenset(info.kind for info in driver.signals)
        self._signals: Final[dict[SignalInfo, tuple[SignalMonitor, SignalPipeline]]] = {
            info: (SignalMonitor(driver.source, info), pipeline_of(info, kinds)) for info in driver.signals
        }
        self._checked_s = self.now_s

    @property
    def body(self) -> SimulatedPerson:
        """Return the person that the sensors are on."""
        return self._driver.person

    def step(self) -> None:
        """Let one packet of time pass, `packet_s` of the driver."""
        self.now_s += self._driver.settings.packet_s
        for samples in self._driver.next_packets():
            monitor, pipeline = self._signals[samples.info]
            checked = monitor.take(samples, self.now_s)
            for report in checked.reports:
                self.state.report(report)
                self._take(pipeline.report(report))
            if checked.samples is not None:
                self._take(pipeline.feed(checked.samples))
        if self.now_s - self._checked_s >= 1.0:
            self._checked_s = self.now_s
            self._look_for_silence()
        rate = self._for_limit()
        has_fault = self.state.has_fault(FeatureName.HEART_RATE, self.now_s)
        self.limit = self.limit.step(rate, self.now_s, has_fault=has_fault)

    def _look_for_silence(self) -> None:
        for monitor, pipeline in self._signals.values():
            report = monitor.silence(self.now_s)
            if report is not None:
                self.state.report(report)
                self._take(pipeline.report(report))

    def _take(self, features: Sequence[Feature]) -> None:
        for feature in features:
            self.state.take(feature, self.now_s)

    def value(self, name: FeatureName) -> FusedValue | None:
        """Return a feature as it is now, None if it was never measured."""
        return self.state.value(name, self.now_s)

    @property
    def heart_rate(self) -> FusedValue | None:
        """Return the heart rate that may be used now: valid, fresh and of calibrated sensors; else None."""
        return self.state.for_limits(FeatureName.HEART_RATE, self.now_s)

    def _for_limit(self) -> HeartRate | None:
        value = self.heart_rate
        return None if value is None else HeartRate(float(value.value), value.at_s, value.period_s)
