"""Company: how much of the processor other machines on the same host took while something was measured.

A virtual machine is not told when it is not run; a figure means little where the host took a tenth of it.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import psutil


@contextmanager
def company_told() -> Iterator[None]:
    """Print the share of the cores that was taken meanwhile, where the system knows (Linux)."""
    before = psutil.cpu_times()
    yield
    after = psutil.cpu_times()
    whole = sum(after) - sum(before)
    if hasattr(after, "steal") and whole > 0:
        share = (after.steal - before.steal) / whole
        print(f"the host gave {share:.1%} of the cores to other machines meanwhile")
