"""Records that are stored in fewer bits than their signal needs, so that it wraps around."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_WRAPS: Final = 4
STEEP_SHARE: Final = 0.3
"""Samples that differ by more of the range than this may have wrapped."""
_JOIN: Final = 20
_BEFORE, _AFTER = 6, 8


def unwrapped(counts: Floats, period: float) -> Floats:
    """Return an ECG as it was before it was stored modulo `period`.

    Around each steep part, a QRS complex, the numbers of wraps are those that make the sum of the squared
    second differences least, with none before and after it: dynamic programming (Viterbi) over the wraps of
    two samples. The slow waves must not wrap. A rule that looks at the next sample only fails where the
    signal crosses more than half of the period from one sample to the next.
    """
    samples = counts.astype(np.float64)
    steep = np.flatnonzero(np.abs(np.diff(counts)) > STEEP_SHARE * period)
    offsets: Floats = np.arange(-MAX_WRAPS, MAX_WRAPS + 1, dtype=np.float64) * period
    for part in np.split(steep, np.flatnonzero(np.diff(steep) > _JOIN) + 1):
        if not len(part):
            continue
        first, end = max(2, part[0] - _BEFORE), min(len(counts), part[-1] + _AFTER)
        samples[first:end] += offsets[_least_bent(counts[first - 2 : end], offsets)]
    return samples


def _least_bent(counts: Floats, offsets: Floats) -> NDArray[np.intp]:
    """Return the index of the offset of each sample but the first two, which have none; nor has the last."""
    none = len(offsets) // 2
    cost = np.full((len(offsets), len(offsets)), np.inf)  # of the offsets of the last two samples
    cost[none, none] = 0.0
    before = []
    for at in range(2, len(counts)):
        oldest, last, now = (counts[at - back] + offsets for back in (2, 1, 0))
        bent = now[None, None, :] - 2 * last[None, :, None] + oldest[:, None, None]
        total = cost[:, :, None] + bent**2
        before.append(total.argmin(axis=0))
        cost = total.min(axis=0)
    path = [none, int(cost[:, none].argmin())]  # from the end
    for back in reversed(before):
        path.append(int(back[path[-1], path[-2]]))
    return np.array(path[::-1][2:])
