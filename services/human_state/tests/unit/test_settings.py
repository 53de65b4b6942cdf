import base64
import os
import subprocess
import sys

import pytest

from handover.errors import UsageError
from handover_body.settings import HumanStateSettings


def test_the_key_of_recordings_has_32_bytes() -> None:
    key = bytes(range(32))
    settings = HumanStateSettings.load(health_recording_key=base64.b64encode(key).decode())
    assert settings.recording_key == key
    assert "AAEC" not in repr(settings)
    assert HumanStateSettings.load(health_recording_key="").recording_key is None


@pytest.mark.parametrize("key", ["short", "é" * 44, base64.b64encode(bytes(16)).decode()])
def test_another_length_is_refused_with_the_way_out(key: str) -> None:
    with pytest.raises(UsageError, match="openssl rand -base64 32"):
        HumanStateSettings.load(health_recording_key=key)


@pytest.mark.nightly
def test_the_process_has_the_niceness_of_the_settings_or_keeps_its_own() -> None:
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    code = "import os; from handover_body.__main__ import use_niceness as use; print(*{}, os.nice(0))"
    asked = f"(use({usual + 1}), use(-20))"
    done = subprocess.run(
        [sys.executable, "-c", code.format(asked)], capture_output=True, text=True, check=True
    )
    higher, lower, niceness = done.stdout.split()
    assert higher == "True"
    assert (lower, int(niceness)) in {("True", -20), ("False", usual + 1)}
