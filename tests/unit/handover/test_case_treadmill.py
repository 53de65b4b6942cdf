"""The study of the trainer on its own clock: heart rates from signals, a seed repeats it."""

import pytest

from handover.cli.case_treadmill import PARTICIPANTS, SEED, perform_study, walk
from handover.errors import UsageError
from services.assistive_devices.machines.treadmill.belt import BeltState, StopReason
from services.assistive_devices.machines.treadmill.training import Plan


def test_a_walker_is_coached_on_a_heart_rate_from_signals_and_a_seed_repeats_it() -> None:
    said: list[str] = []
    first = walk(PARTICIPANTS[1], Plan(100.0), SEED, said.append)
    again = walk(PARTICIPANTS[1], Plan(31.0), SEED, said.append)
    assert list(again.record) == list(first.record)[: len(again.record)]
    assert again.decisions == first.decisions[:1]
    assert (first.belt.state, first.belt.reason) == (BeltState.STOPPED, StopReason.TIME)
    rates = [one.bpm for one in first.record if one.bpm is not None]
    assert len(rates) > 0.95 * len(first.record)
    assert rates[0] == pytest.approx(70, abs=5)
    assert max(rates) > 80, "the walk shows in the heart rate"
    assert len(said) == len(first.decisions) + 1 == 4
    figures = first.figures()
    assert figures.highest_mps <= 1.3
    assert figures.furthest_m < 0.5


def test_a_study_of_a_time_that_cannot_be_is_refused() -> None:
    with pytest.raises(UsageError, match="must be 30 to 3600"):
        perform_study(5.0, print)
