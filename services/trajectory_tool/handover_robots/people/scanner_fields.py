"""The warning and protective fields of a safety scanner, read from digital inputs of a robot controller.

A scanner such as the microScan3 switches an output for each field. Its protective field belongs on a safety
input of the controller as well; what is read here is advisory. An output that is low, or a wire that is
broken, is an infringed field.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from handover.formats.validation import ClosedModel
from handover_datamodels.streams import SOURCE_PATTERN, PeopleReport

PERIOD_S = 0.05

Input = Annotated[int, Field(ge=0, le=63)]


class SafetyScanner(ClosedModel):
    """A scanner at digital inputs, by their numbers; a field without an input is not read."""

    name: Annotated[str, Field(pattern=SOURCE_PATTERN)] = "scanner-1"
    warning_input: Input | None = None
    protective_input: Input | None = None
    infringed: Literal["low", "high"] = "low"
    """The level of an input while its field is infringed."""

    @model_validator(mode="after")
    def _has_an_input(self) -> Self:
        if self.warning_input is None and self.protective_input is None:
            raise ValueError('needs "warning_input", "protective_input" or both')
        return self

    def report(self, inputs: int, stamp_s: float) -> PeopleReport:
        """Return the fields for the levels of all inputs, one bit each."""
        return PeopleReport(
            source=self.name,
            stamp=stamp_s,
            people=(),
            period=PERIOD_S,
            warning_field=self._is_infringed(self.warning_input, inputs),
            protective_field=self._is_infringed(self.protective_input, inputs),
        )

    def _is_infringed(self, number: int | None, inputs: int) -> bool | None:
        if number is None:
            return None
        return bool(inputs >> number & 1) == (self.infringed == "high")


async def read_fields(
    scanner: SafetyScanner,
    inputs: Callable[[], int | None],
    receive: Callable[[PeopleReport], Awaitable[None]],
) -> None:
    """Read the fields until cancelled; while the inputs are unknown, the scanner is silent."""
    while True:
        levels = inputs()
        if levels is not None:
            await receive(scanner.report(levels, time.time()))
        await asyncio.sleep(PERIOD_S)
