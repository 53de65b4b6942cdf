"""Samples and signals refuse what later parts could not interpret."""

import numpy as np
import pytest

from handover_body.model.signals import Samples, SignalInfo, SignalKind

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0)


def test_times_follow_the_rate() -> None:
    samples = Samples("h10", ECG, 100.0, np.zeros((131, 1)))
    assert samples.end_s == pytest.approx(101.0)
    assert samples.sample_times_s()[-1] == samples.end_s


def test_irregular_samples_need_their_times() -> None:
    rate = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
    with pytest.raises(ValueError, match="one time per sample"):
        Samples("h10", rate, 100.0, np.zeros((1, 1)))
    assert Samples("h10", rate, 100.0, np.zeros((1, 1)), np.array([100.5])).end_s == 100.5


def test_a_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(samples, 1\)"):
        Samples("h10", ECG, 100.0, np.zeros((3, 2)))


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), 1e6])
def test_a_rate_that_no_sensor_has_is_refused(rate_hz: float) -> None:
    with pytest.raises(ValueError, match="rate_hz"):
        SignalInfo(SignalKind.ECG, "D82", rate_hz)
