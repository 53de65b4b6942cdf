"""A record whose ECG wraps around its 12 bits is restored sample by sample."""

import numpy as np
import pytest

from benchmarks.body.wrapped_records import unwrapped
from handover_body.processing.synthesis import ecg_of, synthetic_beats


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("peak", [3000, 6000])
def test_an_ecg_that_wraps_several_times_in_a_beat_is_restored(sign: int, peak: int) -> None:
    ecg = ecg_of(synthetic_beats(60, 75, seed=2, ectopic_share=0.05), 60, 250.0)
    counts = np.round(sign * peak * ecg + np.random.default_rng(1).normal(0, 10, len(ecg)))
    stored = (counts + 2048) % 4096 - 2048
    assert (stored != counts).any()
    assert unwrapped(stored, 4096) == pytest.approx(counts)
