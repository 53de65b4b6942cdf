"""The controller of the bed: a bounded feedback, stops, and a backrest that rises only when it may."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_cases.machines.bed.controller import Bed, BedParameters, Signals

DT_S = 0.05
GIVEN = BedParameters()
CALM = Signals(60.0, 3.0, is_lying=True)


def run(bed: Bed, signals: Signals, seconds: float) -> Bed:
    for _ in range(round(seconds / DT_S)):
        bed = bed.step(signals, DT_S)
    return bed


@pytest.fixture
def rocking() -> Bed:
    return run(Bed().start(), CALM, 30.0)


def test_the_worked_example(rocking: Bed) -> None:
    assert rocking.period_s == pytest.approx(4.0)
    assert rocking.amplitude == 1.0
    faster = run(rocking, Signals(80.0, 3.0, is_lying=True), 10.0)
    assert 3.5 - 1e-6 <= faster.period_s < 4.0
    assert run(faster, Signals(80.0, 3.0, is_lying=True), 60.0).period_s == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize(("bpm", "period_s"), [(30, 6.0), (48, 5.0), (60, 4.0), (96, 2.5), (200, 2.5)])
def test_the_period_is_inverse_to_the_heart_rate_within_its_bounds(bpm: float, period_s: float) -> None:
    assert Bed().wanted_period_s(bpm) == pytest.approx(period_s)


@pytest.mark.parametrize(
    "signals",
    [
        Signals(None, 3.0, is_lying=True),
        Signals(60.0, 3.0, is_lying=True, fraction=0.0),
        Signals(60.0, 3.0, is_lying=False),
    ],
)
def test_without_a_heart_rate_a_limit_or_a_sleeper_it_stops_and_lifts_nothing(
    rocking: Bed, signals: Signals
) -> None:
    stopped = run(rocking, signals, 10.0)
    assert stopped.amplitude == 0.0
    assert stopped.backrest_deg == 0.0


def test_one_turn_is_no_restlessness(rocking: Bed) -> None:
    turned = run(rocking, Signals(60.0, 90.0, is_lying=True), 2.0)
    assert not run(turned, CALM, 10.0).is_restless


def test_restlessness_stops_the_rocking_and_then_lifts_the_backrest(rocking: Bed) -> None:
    restless = Signals(60.0, 80.0, is_lying=True)
    bed = rocking
    while not bed.is_restless:
        bed = bed.step(restless, DT_S)
    assert bed.amplitude > 0.9
    while bed.amplitude > 0:
        bed = bed.step(restless, DT_S)
        assert bed.amplitude == 0 or bed.backrest_deg == 0.0, "it still rocks"
    assert run(bed, CALM, 14.0).backrest_deg < GIVEN.raised_deg
    raised = run(bed, CALM, 16.0)
    assert raised.backrest_deg == GIVEN.raised_deg
    assert run(raised, CALM, 60.0).amplitude == 0.0, "it waits for a person"
    again = run(raised.start(), CALM, 40.0)
    assert (again.backrest_deg, again.amplitude) == (0.0, 1.0)


def test_the_backrest_stays_while_nobody_lies(rocking: Bed) -> None:
    bed = run(rocking, Signals(60.0, 80.0, is_lying=True), 18.0)
    assert 0 < bed.backrest_deg < GIVEN.raised_deg
    gone = run(bed, Signals(60.0, 80.0, is_lying=False), 20.0)
    assert gone.backrest_deg == bed.backrest_deg


SIGNALS = st.builds(
    Signals,
    st.one_of(st.none(), st.floats(30, 220)),
    st.one_of(st.none(), st.floats(0, 100)),
    is_lying=st.booleans(),
    fraction=st.floats(0, 1),
)


@settings(max_examples=60)
@given(acts=st.lists(st.tuples(SIGNALS, st.integers(1, 100), st.booleans()), max_size=12))
def test_no_signals_break_the_bounds(acts: list[tuple[Signals, int, bool]]) -> None:
    bed = Bed().start()
    for signals, steps, starts in acts:
        bed = bed.start() if starts else bed
        for _ in range(steps):
            before, bed = bed, bed.step(signals, DT_S)
            assert GIVEN.min_period_s <= bed.period_s <= GIVEN.max_period_s
            assert abs(bed.period_s - before.period_s) <= GIVEN.period_slew_s_per_s * DT_S + 1e-9
            assert 0 <= bed.amplitude <= 1
            assert 0 <= bed.backrest_deg <= GIVEN.raised_deg
            assert abs(bed.backrest_deg - before.backrest_deg) <= GIVEN.backrest_deg_per_s * DT_S + 1e-9
            if signals.heart_rate_bpm is None or signals.fraction == 0 or not signals.is_lying:
                assert bed.amplitude <= before.amplitude
            if bed.backrest_deg > before.backrest_deg:
                assert bed.amplitude == 0
                assert signals.is_lying
                assert bed.is_restless
