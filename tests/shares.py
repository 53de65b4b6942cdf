"""Shares: how the tests of a run are shared out among workers.

A file stays together, so that what its tests have in common is started once; so do files that have something
in common. Files whose tests are long and have nothing in common are taken apart.
"""

from fnmatch import fnmatch
from typing import Final

from xdist.scheduler.loadscope import LoadScopeScheduling

TOGETHER: Final = {
    "tests/e2e/test_*_page.py": "screen",  # one browser at a time is what two cores bear
    "tests/integration/context_broker/test_distributed_*.py": "registered brokers",
    "tests/integration/ros_fiware_bridge/test_both_ways.py": "everyday shop with a robot",
    "tests/integration/ros_fiware_bridge/test_asking.py": "everyday shop with a robot",
}
APART: Final = (
    "tests/e2e/test_demo.py",
    "tests/integration/context_broker/test_crashes*.py",
    "tests/integration/webui/test_live.py",
)


class Shares(LoadScopeScheduling):
    """Gives each worker the next share, in the order of the folders: what is long comes first."""

    def __init__(self, *parts: object) -> None:
        super().__init__(*parts)  # type: ignore[arg-type]  # whatever pytest-xdist hands over
        self.config.option.loadscopereorder = False

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if any(fnmatch(file, pattern) for pattern in APART):
            return nodeid
        return next((name for pattern, name in TOGETHER.items() if fnmatch(file, pattern)), file)
