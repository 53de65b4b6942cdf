"""`handover glove`: the words of the glove bridge, with our settings where the person says nothing."""

import os
from collections.abc import Sequence

from services.gesture_controller.settings import ControllerSettings

TALKS_TO = {
    "forward": ("host", "port"),
    "replay": ("host", "port"),
    "serial": ("host", "port"),
    "simulate": ("host", "port", "controller"),
    "record": ("controller",),
    "calibrate": ("controller",),
}


def bridge_words(said: Sequence[str]) -> list[str]:
    """Return what a person said to the bridge, and before it what `HANDOVER_…` and `.env` say.

    The bridge knows nothing of our settings, since it runs where nothing of ours is installed; of two words
    it takes the later, so that what the person says counts.
    """
    if not said or said[0] not in TALKS_TO:
        return list(said)
    settings = ControllerSettings.load()
    if settings.token is not None:
        os.environ.setdefault("HANDOVER_GLOVE_TOKEN", settings.token)
    known = {
        "host": {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.glove_host, settings.glove_host),  # noqa: S104
        "port": str(settings.glove_port),
        "controller": settings.url_of(settings.controller_port, settings.controller_url),
    }
    ours = [part for word in TALKS_TO[said[0]] for part in (f"--{word}", known[word])]
    return [said[0], *ours, *said[1:]]
