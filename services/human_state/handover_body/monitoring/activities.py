"""The model of activities, loaded in the background when a person first has both sensors that it needs."""

import asyncio
from pathlib import Path
from typing import Any, Final

from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_body.processing.adl.classifier import (
    DEFAULT_MODEL,
    AdlClassifier,
    UnusableModel,
    load_model,
)

log = get_logger(__name__)

ANALYSIS: Final = "analysis"
"""The source of features that follow from those of several sensors."""


class ActivityModel:
    """One model for all persons. Its libraries take seconds to import, so nobody waits for them."""

    def __init__(self, path: Path | None, tasks: BackgroundTasks) -> None:
        self._path: Final = path or DEFAULT_MODEL
        self._tasks: Final = tasks
        self._model: Any = None
        self._is_asked = False

    def classifier(self) -> AdlClassifier | None:
        """Return a classifier for one person; None while the model is loaded, or if it cannot be used."""
        if self._model is not None:
            return AdlClassifier(self._model, ANALYSIS)
        if not self._is_asked:
            self._is_asked = True
            self._tasks.start(self._load)
        return None

    async def _load(self) -> None:
        try:
            self._model = await asyncio.to_thread(load_model, self._path)
        except (UnusableModel, ImportError) as error:
            log.error("activities are not classified", model=str(self._path), reason=str(error))  # noqa: TRY400
