"""Streams of the Lab Streaming Layer stay on this machine; liblsl reads its settings when it is loaded."""

import os

from tests.kit.paths import REPOSITORY

os.environ.setdefault("LSLAPICFG", str(REPOSITORY / "tests" / "kit" / "lsl.cfg"))
