"""ROS domains for tests: tests that run at the same time never share one."""

import random
from collections import deque
from typing import Final

from tests.kit.ports import release, reserve

DOMAINS: Final = range(1, 101)
MAX_RESERVED: Final = 10
"""A process keeps its latest domains, those of more tests than it runs at a time."""

_reserved: deque[int] = deque()


def ros_domain() -> int:
    """Reserve a domain from 1 to 100 that no other process of tests on this machine has."""
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if domain not in _reserved and reserve(domain):
            _reserved.append(domain)
            if len(_reserved) > MAX_RESERVED:
                release(_reserved.popleft())
            return domain
    raise AssertionError("no free ROS domain")
