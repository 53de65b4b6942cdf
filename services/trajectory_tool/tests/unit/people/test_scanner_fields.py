"""The fields of a safety scanner, read from digital inputs."""

import asyncio

import pytest
from pydantic import ValidationError

from handover_datamodels.streams import PeopleReport
from handover_robots.people.scanner_fields import SafetyScanner, read_fields


@pytest.mark.parametrize(
    ("scanner", "inputs", "warning", "protective"),
    [
        ({"warning_input": 1, "protective_input": 0}, 0b11, False, False),
        ({"warning_input": 1, "protective_input": 0}, 0b01, True, False),
        ({"warning_input": 1, "protective_input": 0}, 0b00, True, True),
        ({"protective_input": 7}, 0b1000_0000, None, False),
        ({"warning_input": 2, "infringed": "high"}, 0b100, True, None),
    ],
)
def test_a_low_input_is_an_infringed_field(
    scanner: dict[str, object], inputs: int, warning: bool | None, protective: bool | None
) -> None:
    report = SafetyScanner.model_validate(scanner).report(inputs, 1.0)
    assert (report.warning_field, report.protective_field) == (warning, protective)


@pytest.mark.parametrize("fault", [{}, {"warning_input": 64}, {"warning_input": 1, "name": "a b"}])
def test_an_invalid_scanner_is_refused(fault: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        SafetyScanner.model_validate(fault)


async def test_nothing_is_reported_while_the_inputs_are_unknown() -> None:
    levels: list[int | None] = [None, None, 1, None]
    reports: list[PeopleReport] = []

    def inputs() -> int | None:
        if not levels:
            raise asyncio.CancelledError
        return levels.pop(0)

    async def receive(report: PeopleReport) -> None:
        reports.append(report)

    with pytest.raises(asyncio.CancelledError):
        await read_fields(SafetyScanner(protective_input=0), inputs, receive)
    assert [report.protective_field for report in reports] == [False]
