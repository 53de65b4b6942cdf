import base64

import pytest

from handover.errors import UsageError
from services.human_state.settings import HumanStateSettings


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
