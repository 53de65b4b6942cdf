"""The lifeline of what a run of tests starts: a pipe that breaks when the run ends, however it ends.

Services that are told of it end with it, so that a run which was killed leaves nothing behind.
"""

import os
from typing import Final

from handover.settings import LIFELINE

STDIN, _HELD = os.pipe()  # nothing is ever written: only this process holds the other end
TOLD: Final = {LIFELINE: "1"}
