"""The monitor: compares each value that arrives with the rules, and keeps which Alerts should be active.

A `Watch` is one rule for one value of one device. `observe` is called for every telemetry message and only
updates memory; a watch whose alarm went on or off is put into `changed`, and `AlarmDelivery` stores it,
raises or clears the Alert, and starts the process. So a broker that is away delays no device.

Bounds: at most `MAX_WATCHES` watches, each with at most 64 samples or the baseline of one period. A message
that is older than the last one of its series changes nothing: buffered telemetry is not judged twice.
"""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import orjson

from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.anomalies.detectors import Alarm, Detector, Silence, Verdict, detector_of
from handover_devices.anomalies.rules import Rule
from handover_devices.storage.anomaly_store import WatchRow

log = get_logger(__name__)

MAX_WATCHES: Final = 20_000


class WatchKey(NamedTuple):
    """The name of a rule, of a device and of a value."""

    rule: str
    device: str
    value: str


@dataclass(slots=True)
class Watch:
    """A rule for one value of one device, and what was found; times are seconds since 1970."""

    key: WatchKey
    rule: Rule
    detector: Detector
    alarm: Alarm
    reported: bool = False
    """Whether the Alert in the broker is active, as far as we know."""
    changed_at: float = 0.0
    measured: float = math.nan
    limit: float = math.nan
    process_at: float | None = None
    """When a process was started last."""
    last_t: float = -math.inf
    arrived_s: float = 0.0
    """When the last value arrived, by the monotonic clock."""

    def row(self) -> WatchRow:
        """Return what is stored of the watch."""
        learned = self.detector.state()
        return WatchRow(
            *self.key,
            int(self.alarm.is_on),
            int(self.reported),
            int(self.changed_at * 1e6),
            None if math.isnan(self.measured) else self.measured,
            None if math.isnan(self.limit) else self.limit,
            None if self.process_at is None else int(self.process_at * 1e6),
            None if learned is None else orjson.dumps(learned).decode(),
        )


class Monitor:
    """All watches. `clock` is the time since 1970, `monotonic` that of silence."""

    def __init__(
        self, clock: Callable[[], float] = time.time, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self.rules: dict[str, Rule] = {}
        self.watches: dict[WatchKey, Watch] = {}
        self.skipped = 0
        """Watches that were not made since there are too many."""
        self.changed: dict[WatchKey, Watch] = {}
        self.removed: dict[WatchKey, bool] = {}
        """Watches of rules or devices that are gone; True: the Alert may be active and has to be cleared."""
        self.on_changed: Callable[[], None] = lambda: None
        """Called when there is something in `changed` or `removed`."""
        self._values: dict[str, tuple[str, ...]] = {}
        self._by_series: defaultdict[tuple[str, str], list[Watch]] = defaultdict(list)
        self._known: dict[WatchKey, WatchRow] = {}
        self._clock = clock
        self._monotonic = monotonic

    def load(self, rows: Iterable[WatchRow]) -> None:
        """Forget all; use the state of an earlier run for the watches that are made from now on."""
        for table in (self.rules, self.watches, self.changed, self.removed, self._values, self._by_series):
            table.clear()
        self._known = {WatchKey(row.rule, row.device, row.name): row for row in rows}

    def discard_unknown(self) -> None:
        """Remove the state of an earlier run whose rule or device is gone; its Alerts are cleared."""
        for key, row in self._known.items():
            self.removed[key] = bool(row.is_on or row.reported)
        self._known.clear()
        self.on_changed()

    def set_rule(self, name: str, rule: Rule | None) -> None:
        """Add or replace a rule, or delete it with None. A changed rule begins without a past."""
        for key in [key for key in self.watches if key.rule == name]:
            self._remove(key)
        if rule is None:
            self.rules.pop(name, None)
        else:
            self.rules[name] = rule
            for device, values in self._values.items():
                self._watch(name, rule, device, values)
        self._count()

    def set_device(self, device: str, values: Iterable[str] | None) -> None:
        """Follow a device with these values; None ends that."""
        new = None if values is None else tuple(values)
        if new == self._values.get(device):
            return
        for key in [key for key in self.watches if key.device == device and key.value not in (new or ())]:
            self._remove(key)
        if new is None:
            self._values.pop(device, None)
        else:
            self._values[device] = new
            for name, rule in self.rules.items():
                self._watch(name, rule, device, new)
        self._count()

    def observe(self, device: str, values: Mapping[str, float], t: float) -> None:
        """Judge the values of a message."""
        for name, value in values.items():
            for watch in self._by_series.get((device, name), ()):
                watch.arrived_s = self._monotonic()
                if t > watch.last_t:
                    watch.last_t = t
                    self._apply(watch, t, watch.detector.judge(t, value))

    def check_silence(self) -> None:
        """Judge the values that have not arrived."""
        now_s, t = self._monotonic(), self._clock()
        for watch in self.watches.values():
            if isinstance(watch.detector, Silence):
                self._apply(watch, t, watch.detector.judge_silence(now_s - watch.arrived_s))

    def postpone_first(self) -> None:
        """Move what would be delivered first to the end."""
        if self.removed:
            key = next(iter(self.removed))
            self.removed[key] = self.removed.pop(key)
        elif self.changed:
            key = next(iter(self.changed))
            self.changed[key] = self.changed.pop(key)

    def _apply(self, watch: Watch, t: float, verdict: Verdict) -> None:
        if watch.alarm.update(t, verdict.judgement):
            watch.changed_at = t
            watch.measured, watch.limit = verdict.measured, verdict.limit
            metrics.ANOMALIES.labels("on" if watch.alarm.is_on else "off").inc()
            self.changed[watch.key] = watch
            self.on_changed()

    def _watch(self, name: str, rule: Rule, device: str, values: Iterable[str]) -> None:
        for value in values:
            key = WatchKey(name, device, value)
            if key in self.watches or not rule.concerns(device, value):
                continue
            if len(self.watches) >= MAX_WATCHES:
                self.skipped += 1
                continue
            watch = self.watches[key] = self._make(key, rule, self._known.pop(key, None))
            self._by_series[device, value].append(watch)
            if watch.alarm.is_on != watch.reported:
                self.changed[key] = watch
                self.on_changed()

    def _make(self, key: WatchKey, rule: Rule, row: WatchRow | None) -> Watch:
        alarm = Alarm(rule.for_s, rule.clear_after_s)
        learned = None if row is None or row.learned is None else orjson.loads(row.learned)
        watch = Watch(key, rule, detector_of(rule, learned), alarm, arrived_s=self._monotonic())
        if row is not None:
            alarm.is_on, watch.reported = bool(row.is_on), bool(row.reported)
            watch.changed_at = row.changed_us / 1e6
            watch.measured = math.nan if row.measured is None else row.measured
            watch.limit = math.nan if row.limit_value is None else row.limit_value
            watch.process_at = None if row.process_us is None else row.process_us / 1e6
        return watch

    def _remove(self, key: WatchKey) -> None:
        watch = self.watches.pop(key)
        self._by_series[key.device, key.value].remove(watch)
        if not self._by_series[key.device, key.value]:
            del self._by_series[key.device, key.value]
        self.changed.pop(key, None)
        self.removed[key] = watch.alarm.is_on or watch.reported
        self.on_changed()

    def _count(self) -> None:
        metrics.WATCHES.set(len(self.watches))
        if self.skipped:
            log.error("too many watches", skipped=self.skipped, maximum=MAX_WATCHES)
