"""Equal warnings are written once in ten minutes, then with their number."""

import io
import logging
from collections.abc import Iterator

import pytest
import structlog

from handover.logs.repeated_lines import PAUSE_S, RepeatedLines


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def written(clock: Clock) -> Iterator[io.StringIO]:
    """What a logger with the filter writes."""
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.addFilter(RepeatedLines(clock))
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            processor=structlog.processors.KeyValueRenderer(drop_missing=True),
            foreign_pre_chain=[structlog.stdlib.ExtraAdder()],
        )
    )
    logger = logging.getLogger("lamp")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    yield stream
    logger.removeHandler(handler)
    logger.propagate = True


def own_logger() -> structlog.stdlib.BoundLogger:
    return structlog.wrap_logger(
        logging.getLogger("lamp"),
        wrapper_class=structlog.stdlib.BoundLogger,
        processors=[
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
    )


def test_an_equal_line_is_counted(written: io.StringIO, clock: Clock) -> None:
    log = own_logger()
    for port in range(50_000, 50_100):
        clock.now_s += 1
        log.warning("broker unavailable", error=f"connection from 127.0.0.1:{port} refused\nmore")
    assert written.getvalue().count("broker unavailable") == 1
    clock.now_s += PAUSE_S
    log.warning("broker unavailable", error="connection from 127.0.0.1:1 refused")
    assert written.getvalue().splitlines()[-1].endswith("repeated=99")


def test_another_field_level_text_or_error_is_another_line(written: io.StringIO) -> None:
    log = own_logger()
    log.warning("lamp broken", lamp="a")
    log.warning("lamp broken", lamp="b")
    log.error("lamp broken", lamp="a")
    log.warning("lamp gone", lamp="a")
    log.warning("lamp gone", lamp="a", error="refused")
    log.warning("lamp gone", lamp="a", error="timed out")
    assert len(written.getvalue().splitlines()) == 6


def test_what_happens_is_never_dropped(written: io.StringIO) -> None:
    for _ in range(3):
        own_logger().info("lamp lit")
    assert written.getvalue().count("lamp lit") == 3


def test_a_traceback_is_written_once_by_libraries_too(written: io.StringIO) -> None:
    for _ in range(3):
        for text in ("seven", "eight"):
            try:
                int(text)
            except ValueError:
                logging.getLogger("lamp").exception("request failed")
                own_logger().exception("task failed")
    assert written.getvalue().count("request failed") == 2
    assert written.getvalue().count("task failed") == 2
