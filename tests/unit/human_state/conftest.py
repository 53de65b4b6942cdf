"""Streams of the Lab Streaming Layer stay on this machine; liblsl reads its settings when it is loaded."""

import os
from pathlib import Path

os.environ.setdefault("LSLAPICFG", str(Path(__file__).parents[2] / "kit" / "lsl.cfg"))
