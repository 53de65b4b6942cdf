"""Telemetry: structured log lines with the task and the process.

`log.info("task accepted", task=task_id)` is a readable line (`HANDOVER_LOG_FORMAT=text`) or a JSON object
(`json`). `working_on` adds fields to all lines inside its context.
"""

import logging
import sys
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager
from typing import Any, Final, cast

import structlog
from structlog.typing import Processor

from handover.logs.log_files import LogFileHandler, own_log
from handover.logs.repeated_lines import RepeatedLines
from handover.settings import Settings

_LOGGED: Final = "handover_logged"
"""The attribute of an exception that has been logged."""


def log_to_stderr() -> None:
    """Send log lines to standard error: the standard output of a command is its result, such as a file.

    Commands call this before anything else; a service calls `set_up_logging` with its settings.
    """
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),  # the present one, not that at this call
        cache_logger_on_first_use=False,
    )


def set_up_logging(settings: Settings, service: str) -> None:
    """Send all logs, including those of libraries, to standard error in one format."""
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.ExtraAdder(),
        _without_uvicorns_colours,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    renderer: Processor
    if settings.log_format == "json":
        shared.append(
            structlog.processors.ExceptionRenderer(
                structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
            )
        )
        renderer = structlog.processors.JSONRenderer()
    else:
        renderer = structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(),
            pad_event_to=0,
            exception_formatter=structlog.dev.plain_traceback,  # a rich one would show secrets
        )
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )
    file = own_log()
    handler = logging.StreamHandler(sys.stderr) if file is None else LogFileHandler(file)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    handler.addFilter(RepeatedLines())
    logging.getLogger("uvicorn.error").addFilter(_is_new)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(settings.log_level.upper())
    for chatty in ("httpx", "httpcore", "uvicorn.access"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    structlog.contextvars.bind_contextvars(service=service)


def _without_uvicorns_colours(_: Any, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    event.pop("color_message", None)
    return event


def mark_logged(error: BaseException) -> None:
    """Leave `error`, which was logged, out of the log of uvicorn, which gets it after the response."""
    error.__dict__[_LOGGED] = True


def _is_new(record: logging.LogRecord) -> bool:
    error = record.exc_info and record.exc_info[1]
    return not (isinstance(error, BaseException) and error.__dict__.get(_LOGGED))


def get_logger(name: str) -> structlog.stdlib.BoundLogger:
    """Return the logger of a module; call it with `__name__`."""
    return cast("structlog.stdlib.BoundLogger", structlog.get_logger(name))


@contextmanager
def working_on(**ids: Any) -> Iterator[None]:
    """Add fields such as `task=…` and `process=…` to every log line inside the context."""
    with structlog.contextvars.bound_contextvars(**ids):
        yield
