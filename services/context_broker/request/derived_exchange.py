"""Request contexts derived from others, for a part of an operation."""

import copy
from typing import Any

from services.context_broker.request.request_context import RequestContext


def derived(exchange: RequestContext, **changes: Any) -> RequestContext:
    """Return a copy of the request context with some attributes changed."""
    result = copy.copy(exchange)
    for name, value in changes.items():
        setattr(result, name, value)
    return result
