"""A broker, a controller and the study service as processes."""

from collections.abc import AsyncIterator

import httpx
import pytest

from handover.broker import BrokerClient
from services.gesture_controller.tests.integration.conftest import Bench, put_on, running_cell, silence_s
from tests.kit.cell import Cell

__all__ = ["put_on", "running_cell", "silence_s"]


class StudyBench(Bench):
    """The workplace, and a client of the study service."""

    def __init__(self, cell: Cell, broker: BrokerClient) -> None:
        super().__init__(cell, broker)
        self.study = httpx.Client(base_url=cell.url("study"), timeout=120, trust_env=False)


@pytest.fixture
async def bench(running_cell: Cell) -> AsyncIterator[StudyBench]:
    """The workplace with the study service."""
    running_cell.run("study")
    async with BrokerClient(running_cell.settings) as broker:
        made = StudyBench(running_cell, broker)
        try:
            yield made
        finally:
            made.screen.close()
            made.study.close()
