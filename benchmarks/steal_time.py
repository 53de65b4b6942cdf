"""Steal time: the CPU time that the host gave to other virtual machines during a measurement.

A virtual machine does not notice when it is suspended; a figure means little if the host took a tenth of it.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import psutil


@contextmanager
def report_steal_time() -> Iterator[None]:
    """Print the share of stolen CPU time during the context, if the system reports it (Linux)."""
    before = psutil.cpu_times()
    yield
    after = psutil.cpu_times()
    whole = sum(after) - sum(before)
    if hasattr(after, "steal") and whole > 0:
        share = (after.steal - before.steal) / whole
        print(f"steal time: {share:.1%} of the CPU time")
