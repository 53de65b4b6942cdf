"""ROS domains for tests: tests that run at the same time never share one."""

import os
import random
from typing import Final

MAX_DOMAIN: Final = 100


def ros_domain() -> int:
    """Return a domain from 1 to 100 that no other worker of this run uses."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    workers = max(int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")), worker + 1)
    size = max(MAX_DOMAIN // workers, 1)
    return 1 + (worker * size + random.randrange(size)) % MAX_DOMAIN
