"""Random samples and features."""

import numpy as np
from hypothesis import strategies as st

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

UNITS = {
    SignalKind.HEART_RATE: "BPM",
    SignalKind.BREATHING_RATE: "C94",
    SignalKind.SPO2: "P1",
    SignalKind.SKIN_TEMPERATURE: "CEL",
    SignalKind.DISTANCE: "MTR",
    SignalKind.INTER_BEAT_INTERVAL: "SEC",
    SignalKind.ECG: "D82",
}
TEXTS = {FeatureName.ACTIVITY, FeatureName.POSTURE, FeatureName.SLEEP_POSITION, FeatureName.WEAR_STATE}

times = st.integers(1_000_000_000_000, 2_000_000_000_000).map(lambda millis: millis / 1000)
words = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=8)
methods = st.text(st.characters(categories=["L", "N", "P", "S"]), max_size=8)
names = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=8)


@st.composite
def samples(draw: st.DrawFn, kinds: st.SearchStrategy[SignalKind] | None = None) -> Samples:
    """Draw samples of any signal: with a rate, or with a time for each."""
    kind = draw(st.sampled_from(SignalKind) if kinds is None else kinds)
    one = kind in UNITS
    channels = ("",) if one else tuple(draw(st.lists(names, min_size=1, max_size=3, unique=True)))
    number = draw(st.integers(1, 6))
    rate_hz = draw(st.none() | st.sampled_from([0.333, 1.0, 10.0, 130.0, 500.25]))
    if kind is SignalKind.INTER_BEAT_INTERVAL:
        rate_hz = None
    start_s = draw(times)
    steps = draw(st.lists(st.integers(0, 5000), min_size=number, max_size=number))
    values = draw(
        st.lists(
            st.floats(-1e6, 1e6) | st.just(float("nan")),
            min_size=number * len(channels),
            max_size=number * len(channels),
        )
    )
    return Samples(
        source=draw(names),
        info=SignalInfo(
            kind,
            UNITS.get(kind, draw(st.sampled_from(["", "D82", "K40"]))),
            rate_hz,
            channels,
            draw(st.sampled_from([-np.inf, -1000.0])),
            draw(st.sampled_from([np.inf, 1000.0])),
            draw(st.none() | st.just(0.5)),
            draw(words),
        ),
        start_s=start_s,
        values=np.array(values).reshape(number, len(channels)),
        times_s=start_s + np.cumsum([0, *steps[1:]]) / 1000 if rate_hz is None else None,
        clock=draw(st.sampled_from(ClockKind)),
        uncertainty_s=draw(st.sampled_from([0.0, 0.01])),
        quality=draw(st.floats(0, 1)),
        has_contact=draw(st.none() | st.booleans()),
    )


@st.composite
def features(draw: st.DrawFn, only: st.SearchStrategy[FeatureName] | None = None) -> Feature:
    """Draw a feature of any name."""
    name = draw(st.sampled_from(FeatureName) if only is None else only)
    return Feature(
        name,
        draw(names),
        draw(st.sampled_from(["Rest", "Using Phone"]) if name in TEXTS else st.floats(-1e6, 1e6)),
        draw(times),
        draw(st.floats(0, 1)),
        draw(st.sampled_from(Status)),
        draw(methods),
        draw(st.sampled_from([0.0, 30.0])),
        draw(st.sampled_from([0.5, 1.0])),
        draw(st.booleans()),
    )


def same_values(one: Samples, other: Samples, *, times_within_s: float = 1e-6) -> bool:
    """Return whether two samples have the same values at the same times."""
    return (
        one.source == other.source
        and one.info.kind is other.info.kind
        and one.values.shape == other.values.shape
        and bool(np.allclose(one.values, other.values, rtol=1e-9, equal_nan=True))
        and bool(np.allclose(one.sample_times_s(), other.sample_times_s(), rtol=0, atol=times_within_s))
    )
