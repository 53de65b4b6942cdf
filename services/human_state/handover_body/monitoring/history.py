"""The history of persons who allow it: one value a second at most, deleted after the retention."""

import asyncio
import time
from typing import Final

from handover_body.fusion.person_state import FusedValue
from handover_body.model.features import FeatureName
from handover_body.monitoring.monitoring import Monitoring
from handover_body.people.consent import Purpose
from handover_body.storage.store import Store, ValueRow

SAMPLE_EVERY_S: Final = 1.0
WRITE_EVERY_S: Final = 5.0
EXPIRE_EVERY_S: Final = 600.0
MAX_WAITING: Final = 100_000
DAY_US: Final = 86_400_000_000


class HistoryWriter:
    """Collects values and writes them in batches."""

    def __init__(self, store: Store, monitoring: Monitoring, keep_days: float) -> None:
        self._store = store
        self._monitoring = monitoring
        self._keep_us = int(keep_days * DAY_US)
        self._rows: list[ValueRow] = []
        self._seen: dict[tuple[str, FeatureName], float] = {}
        self._turn = asyncio.Lock()

    async def run(self) -> None:
        """Collect and write until cancelled; the last values are written at the end."""
        written_s = expired_s = -EXPIRE_EVERY_S
        try:
            while True:
                self._collect()
                now_s = time.monotonic()
                if now_s - written_s >= WRITE_EVERY_S:
                    written_s = now_s
                    await self.flush()
                if now_s - expired_s >= EXPIRE_EVERY_S:
                    expired_s = now_s
                    before_us = time.time_ns() // 1000 - self._keep_us
                    await asyncio.to_thread(self._store.delete_old_values, before_us)
                await asyncio.sleep(SAMPLE_EVERY_S)
        finally:
            self._store.add_values(self._rows)
            self._rows = []

    async def flush(self) -> None:
        """Write what was collected."""
        async with self._turn:
            rows, self._rows = self._rows, []
            try:
                await asyncio.to_thread(self._store.add_values, rows)
            except Exception:
                self._rows = [*rows, *self._rows][-MAX_WAITING:]
                raise

    async def forget(self, subject: str) -> None:
        """Delete what waits to be written of a pseudonym, also what is being written."""
        async with self._turn:
            self._rows = [row for row in self._rows if row.subject != subject]
            self._seen = {key: at for key, at in self._seen.items() if key[0] != subject}

    def _collect(self) -> None:
        now_s = time.monotonic()
        offset_s = time.time() - now_s
        for monitor in self._monitoring.monitors.values():
            if Purpose.HISTORY not in monitor.person.purposes():
                continue
            subject = monitor.person.pseudonym
            for value in monitor.values(now_s):
                key = subject, value.name
                if self._seen.get(key) != value.at_s:
                    self._seen[key] = value.at_s
                    self._rows.append(_row(subject, value, offset_s))


def _row(subject: str, value: FusedValue, offset_s: float) -> ValueRow:
    is_text = isinstance(value.value, str)
    return ValueRow(
        subject,
        value.name,
        int((value.at_s + offset_s) * 1e6),
        None if is_text else float(value.value),
        str(value.value)[:64] if is_text else None,
        value.quality,
        value.status,
    )
