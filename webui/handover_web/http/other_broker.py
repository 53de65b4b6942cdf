"""What the page changes at a broker that is not ours and knows no rights of this cell: they are checked here.

With accounts, nothing else reaches such a broker through this server, and no credentials of a person do.
"""

import re
from typing import Any, Final
from urllib.parse import unquote

import orjson
from starlette.requests import Request
from starlette.responses import Response

from handover.broker import BrokerClient, BrokerUnavailable
from handover.errors import Problem
from handover.messages import message
from handover.security.authentication import not_allowed
from handover.security.caller import LOCAL_OWNER
from handover.security.guard import authenticated
from handover.security.permissions import Permission
from handover.service_addresses import BROKER

_ATTRIBUTES_OF_TASK: Final = re.compile(r"ngsi-ld/v1/entities/(urn:ngsi-ld:Task:[^/]+)/attrs")


class OtherBroker:
    """The requests of people for a broker that may not be ours."""

    def __init__(self, broker: BrokerClient) -> None:
        self._broker = broker

    async def answer(self, path: str, request: Request) -> Response | None:
        """Return the answer to a request at `path` (percent-encoded); None if the proxy may pass it on.

        Raises `Problem`: 403 for a request that only the broker itself may answer, or without permission.
        """
        caller = await authenticated(request)
        if caller is LOCAL_OWNER or await self._is_ours():
            return None
        task = _ATTRIBUTES_OF_TASK.fullmatch(unquote(path))
        if request.method != "POST" or task is None:
            raise Problem(
                403,
                "Not through this server",
                f"the broker {self._broker.url} is not part of Handover and knows no rights of this cell; "
                "send the request to its own address, with credentials of its own",
            )
        if not caller.may(Permission.WRITE_ENTITIES, task[1]):
            raise not_allowed(caller, Permission.WRITE_ENTITIES, task[1])
        await self._broker.append(task[1], _object(await request.body()))
        return Response(status_code=204)

    async def _is_ours(self) -> bool:
        try:
            return (await self._broker.identity()).is_ours
        except BrokerUnavailable:
            raise Problem(
                502,
                "Service unavailable",
                message(
                    "page.service_unavailable",
                    "{service} does not respond ({url}); check its state on the page Services and try again",
                    service=BROKER,
                    url=self._broker.url,
                ),
            ) from None


def _object(body: bytes) -> dict[str, Any]:
    try:
        document = orjson.loads(body)
    except orjson.JSONDecodeError:
        document = None
    if not isinstance(document, dict):
        raise Problem(400, "Bad request", "the body is no JSON object of attributes")
    return document
