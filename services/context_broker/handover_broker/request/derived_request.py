"""Requests made from other ones, for a part of an operation."""

import copy
from typing import Any

from handover_broker.request.request_context import RequestContext


def derived(request: RequestContext, **changes: Any) -> RequestContext:
    """Return a copy of the request with some attributes changed."""
    result = copy.copy(request)
    for name, value in changes.items():
        setattr(result, name, value)
    return result
