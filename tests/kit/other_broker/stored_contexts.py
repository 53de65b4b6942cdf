"""User @contexts of the strict broker: loaded once, checked, and kept for ever unless they are reloaded.

The broker behind gets the address of a copy at the strict broker, so that it never sees another content.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from handover.network.http_client import BodyReadingHttpClient, SendError
from handover_datamodels.contexts import HANDOVER_URL, is_core, resolve
from tests.kit.other_broker.profiles import Refused, problem

CONTEXT_LINK: Final = re.compile(r"<([^>]*)>(?=[^,]*json-ld#context)")
PATH: Final = "/contexts/"
TIMEOUT_S: Final = 600.0


class StoredContexts:
    """The contexts in `state`, which `save` makes durable; the copies are below `url`."""

    def __init__(
        self,
        state: dict[str, Any],
        save: Callable[[], None],
        http: BodyReadingHttpClient,
        url: str,
        *,
        is_checked: bool,
    ) -> None:
        self._latest: dict[str, str] = state.setdefault("contexts", {})
        self._copies: dict[str, tuple[str, Any]] = state.setdefault("copies", {})
        self._save, self._http, self._url, self._is_checked = save, http, f"{url}{PATH}", is_checked

    def copy(self, path: str) -> Any:
        """Return the copy at a path."""
        return self._copies[path.removeprefix(PATH)][1]

    async def replace(self, headers: dict[str, str], body: Any) -> None:
        """Put the addresses of copies into the Link header and the documents of a request."""
        if match := CONTEXT_LINK.search(headers.get("link", "")):
            headers["link"] = headers["link"].replace(match[1], await self._stored(match[1]))
        for document in body if isinstance(body, list) else [body]:
            if isinstance(document, dict) and "@context" in document:
                document["@context"] = await self._stored(document["@context"])

    def restore(self, text: str) -> str:
        """Return a text with the addresses that the client has given in place of those of copies."""
        found = re.escape(self._url) + "([0-9a-f]{64})"
        return re.sub(found, lambda match: self._copies[match[1]][0], text)

    async def reload(self, url: str) -> None:
        """Load a context again; refuse if it was never loaded."""
        if url not in self._latest:
            raise Refused(problem(404, "Context Not Found", url))
        await self._load(url)

    async def _stored(self, context: Any) -> Any:
        if isinstance(context, list):
            return [await self._stored(part) for part in context]
        if isinstance(context, Mapping):
            self._check(context)
        if not isinstance(context, str) or is_core(context):
            return context
        if context not in self._latest:
            await self._load(context)
        return self._url + self._latest[context]

    async def _load(self, url: str) -> None:
        document = None if url == HANDOVER_URL else resolve(url)  # the published ones, without the network
        try:
            if document is None:
                reply = await self._http.request("GET", url, [], b"", TIMEOUT_S)
                document = json.loads(reply.body)
            content = {"@context": await self._stored(document["@context"])}
        except (SendError, ValueError, LookupError, TypeError) as error:
            raise Refused(problem(503, "Unable to load the @context", f"{url}: {error}")) from None
        copy = hashlib.sha256(json.dumps([url, content], sort_keys=True).encode()).hexdigest()
        self._latest[url], self._copies[copy] = copy, (url, content)
        self._save()

    def _check(self, context: Mapping[str, Any]) -> None:
        wrong = [name for name, value in context.items() if not isinstance(value, str | dict)]
        if wrong and self._is_checked:
            raise Refused(problem(400, "Invalid key-value in @context", wrong[0]))
