"""How tests are distributed to the workers of a run.

The tests of a file stay together, so that what they share is started once. The same holds for groups of files
that share something. The tests of the files in `SEPARATE` take long and share nothing: each may run anywhere.
"""

from fnmatch import fnmatch
from typing import Final

from xdist.scheduler.loadscope import LoadScopeScheduling

TOGETHER: Final = {
    "tests/e2e/test_*_page.py": "screen",  # two cores bear one browser at a time
    "tests/e2e/test_humanoid_vr.py": "screen",
    "services/context_broker/tests/integration/test_distributed_*.py": "registered brokers",
    "ros_fiware_bridge/tests/integration/test_both_ways.py": "shared shop with a robot",
    "ros_fiware_bridge/tests/integration/test_requests.py": "shared shop with a robot",
}
SEPARATE: Final = (
    "tests/e2e/test_demo.py",
    "services/context_broker/tests/integration/test_crashes*.py",
    "webui/tests/integration/test_live.py",
)


class GroupScheduling(LoadScopeScheduling):
    """Gives each worker the next group, in the order of the folders: long tests come first."""

    def __init__(self, *parts: object) -> None:
        super().__init__(*parts)  # type: ignore[arg-type]  # whatever pytest-xdist passes
        self.config.option.loadscopereorder = False

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if any(fnmatch(file, pattern) for pattern in SEPARATE):
            return nodeid
        return next((name for pattern, name in TOGETHER.items() if fnmatch(file, pattern)), file)
