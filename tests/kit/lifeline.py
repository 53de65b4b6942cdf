"""A pipe that breaks when the test run ends, however it ends.

Services that get `ENVIRONMENT` and `STDIN` end when the pipe breaks. Thus a run that was killed leaves no
process behind.
"""

import os
from typing import Final

from handover.settings import LIFELINE

STDIN, _WRITE_END = os.pipe()  # nothing is ever written; only this process holds the other end
ENVIRONMENT: Final = {LIFELINE: "1"}
