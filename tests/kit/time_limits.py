"""The time limit of a test, in seconds of an idle machine, as all bounds of `waiting`.

pytest-timeout measures wall time: with a load average of 30, a test of one minute exceeds a limit of ten. Its
alarm is thus delayed while the machine is slow.
"""

import signal
from types import FrameType
from typing import Final

from tests.kit.waiting import Bound

SAMPLE_S: Final = 30.0
"""How often the load is measured; a shorter test is not interrupted at all."""


def scale_alarm(limit_s: float) -> None:
    """Delay the alarm that has been set for `limit_s` until so much time of an idle machine has passed."""
    expire = signal.getsignal(signal.SIGALRM)
    if not callable(expire):
        return  # the limit is kept by a thread
    bound = Bound(limit_s)

    def on_alarm(number: int, frame: FrameType | None) -> None:
        if remaining_s := bound.remaining_s():
            signal.setitimer(signal.ITIMER_REAL, min(remaining_s, SAMPLE_S))
        else:
            expire(number, frame)

    signal.signal(signal.SIGALRM, on_alarm)
    signal.setitimer(signal.ITIMER_REAL, min(limit_s, SAMPLE_S))
