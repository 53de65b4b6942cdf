"""The watchdog: a service is restarted if it is silent although it works, and at most once a minute."""

import os
import time

from hypothesis import given
from hypothesis import strategies as st

from handover.serving.watchdog import (
    MAX_SILENCE_S,
    MIN_CPU_S,
    MIN_LOOKS,
    MIN_RESTART_INTERVAL_S,
    Patience,
    Verdict,
    cpu_time_s,
)


def verdict(patience: Patience, silent_s: float, cpu_s: float | None, now_s: float = 1000.0) -> Verdict:
    return patience.verdict(now_s, asked_s=now_s - silent_s, looks=MIN_LOOKS, cpu_s=cpu_s)


@given(st.floats(0, 300), st.one_of(st.none(), st.floats(0, 300)), st.integers(0, 30))
def test_a_service_is_restarted_only_if_it_was_silent_and_worked(
    silent_s: float, cpu_s: float | None, looks: int
) -> None:
    stuck = silent_s >= MAX_SILENCE_S and looks >= MIN_LOOKS and cpu_s is not None and cpu_s >= MIN_CPU_S
    judged = Patience().verdict(silent_s, asked_s=0.0, looks=looks, cpu_s=cpu_s)
    assert (judged is Verdict.STUCK) == stuck


def test_silence_without_work_is_only_reported() -> None:
    assert verdict(Patience(), 300.0, MIN_CPU_S - 0.1) is Verdict.SLOW
    assert verdict(Patience(), 300.0, None) is Verdict.SLOW, "where the processor time is unknown"


def test_a_service_is_restarted_once_a_minute_at_most() -> None:
    patience = Patience()
    restarts = [now_s for now_s in range(600) if verdict(patience, 20.0, 20.0, float(now_s)) is Verdict.STUCK]
    assert restarts == list(range(0, 600, int(MIN_RESTART_INTERVAL_S)))


def test_the_processor_time_of_a_process_is_that_of_its_work() -> None:
    before_s, own_s = cpu_time_s(os.getpid()), time.process_time()
    assert before_s is not None
    while time.process_time() < own_s + 0.2:
        pass
    after_s = cpu_time_s(os.getpid())
    assert after_s is not None
    assert after_s >= before_s + 0.1
    assert cpu_time_s(2**22 + 1) is None, "no process has this number"
