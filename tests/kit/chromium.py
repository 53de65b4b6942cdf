"""The browser of the tests: Debian's Chromium, or Google's Chrome."""

import shutil
from pathlib import Path
from typing import Final

import pytest

FLAGS: Final = (
    "--disable-gpu",
    "--disable-quic",
    "--disable-sync",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
)


def chromium() -> str:
    """Return the program that starts the browser; skip the test where none is installed."""
    if shutil.which("chromium") is None and shutil.which("google-chrome") is None:
        pytest.skip("Chromium is not installed; on Debian and Ubuntu: sudo apt install chromium")
    return str(Path(__file__).with_name("chromium.sh"))
