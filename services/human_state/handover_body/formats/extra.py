"""The libraries of the extra `human-state`, imported when they are needed."""

import importlib
from types import ModuleType

from handover.distribution import install_command
from handover_body.formats.errors import ExchangeError


def required(module: str) -> ModuleType:
    """Return a module. Raises `ExchangeError`, which names the extra, if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ExchangeError(
            f"{module} is not installed ({error}); install the extra: {install_command('body')}"
        ) from error
