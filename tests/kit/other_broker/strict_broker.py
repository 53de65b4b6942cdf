"""A strict context broker for tests: a profile of answers before another broker.

`python -m tests.kit.other_broker.strict_broker` passes requests on to the broker at `STRICT_BROKER_TARGET`,
and refuses or changes what its profile (`STRICT_BROKER_PROFILE`) says. That broker notifies the subscribers.
With `STRICT_BROKER_TENANT` everything is in this tenant of it. In `STRICT_BROKER_FOLDER` the file
`database-away` is a switch, and `strict-broker.json` has what lasts beyond a restart.
"""

import json
import os
import re
import sys
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qsl, quote, unquote, urlencode

import uvicorn
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from handover.network.http_client import (
    BodyReadingHttpClient,
    SendError,
    StreamedResponse,
    StreamingHttpClient,
)
from tests.kit.other_broker.profiles import BATCHES, RULES, Answer, Profile, Refused, problem, profile_of
from tests.kit.other_broker.stored_contexts import PATH as CONTEXTS
from tests.kit.other_broker.stored_contexts import TIMEOUT_S, StoredContexts

API: Final = "/ngsi-ld/v1/"
DATABASE_AWAY: Final = "database-away"
OWN_HEADERS: Final = frozenset(
    {"host", "content-length", "connection", "transfer-encoding", "accept-encoding", "keep-alive"}
)
Change = Callable[[int, bytes], tuple[int, bytes]]
"""Returns the status and body to answer in place of those of the broker behind."""


@dataclass
class ProxiedCall:
    """A request, as the rules see it."""

    broker: "StrictBroker"
    method: str
    path: str
    params: dict[str, str]
    headers: dict[str, str]
    tenant: str
    raw: bytes
    body: Any = None
    entities: list[dict[str, Any]] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    is_done: bool = False
    """Nothing is left to pass on."""

    def __post_init__(self) -> None:
        with suppress(ValueError):
            self.body = json.loads(self.raw)
        place = self.path.split("/")
        if self.path in BATCHES and isinstance(self.body, list):
            self.entities = [one for one in self.body if isinstance(one, dict)]
        elif place[0] == "entities" and isinstance(self.body, dict):
            self.entities = [{place[3]: self.body} if len(place) == 4 else self.body]

    @property
    def size(self) -> int:
        return len(self.raw)

    @property
    def is_database_away(self) -> bool:
        return (self.broker.folder / DATABASE_AWAY).exists()

    @property
    def creating(self) -> set[str]:
        return self.broker.creating

    async def stored(self, path: str) -> dict[str, Any] | None:
        names = {name: value for name, value in self.headers.items() if name in {"link", "authorization"}}
        reply = await self.broker.ask("GET", quote(API + path, safe=":/"), self.out(names))
        found: dict[str, Any] | None = json.loads(reply.body) if reply.status == 200 else None
        return found

    def out(self, headers: dict[str, str]) -> list[tuple[str, str]]:
        """Return headers for the broker behind."""
        tenant = {"ngsild-tenant": self.tenant} if self.tenant else {}
        return list({**headers, **tenant}.items())

    def refuse(self, entity: dict[str, Any], status: int, title: str) -> None:
        if self.path not in BATCHES:
            raise Refused(problem(status, title))
        self.body = [one for one in self.body if one is not entity]
        self.entities = [one for one in self.entities if one is not entity]
        self.is_done = not self.body
        error = {"entityId": entity.get("id"), "error": {**problem(status, title).body, "status": status}}

        def add_error(answered: int, body: bytes) -> tuple[int, bytes]:
            if answered >= 300:
                return answered, body
            accepted = [one.get("id") for one in self.body]
            before = json.loads(body) if answered == 207 else {"success": accepted, "errors": []}
            return 207, json.dumps({**before, "errors": [*before["errors"], error]}).encode()

        self.changes.append(add_error)

    def leave_out(self, names: list[str]) -> None:
        for name in names:
            del self.body[name]
        left = [name for name in self.body if name not in {"@context", "id", "type"}]
        self.is_done = not left
        undone = {"statusCode": 404, "title": "Attributes Not Found", "attributes": names}

        def report(answered: int, body: bytes) -> tuple[int, bytes]:
            before = json.loads(body) if answered == 207 else {"updated": left, "notUpdated": []}
            changed = {**before, "notUpdated": [*before["notUpdated"], undone]}
            return (207, json.dumps(changed).encode()) if answered < 300 else (answered, body)

        self.changes.append(report)

    def spoil(self, entity: dict[str, Any]) -> None:
        kinds = entity.get("type") if isinstance(entity.get("type"), list) else [entity.get("type")]
        self.broker.state["spoiled"].append([self.tenant, entity["id"], kinds])
        self.broker.save()

    def is_spoiled(self) -> bool:
        if self.method != "GET":
            return False
        kinds = set(filter(None, re.split(r"[,|;()]", self.params.get("type", ""))))
        return any(
            self.path == f"entities/{name}"
            or (self.path == "entities" and not (kinds and kinds.isdisjoint(of_it)))
            for tenant, name, of_it in self.broker.state["spoiled"]
            if tenant == self.tenant
        )


class StrictBroker:
    """The ASGI application; `url` is its own address, at which `target` loads the stored contexts."""

    def __init__(
        self, profile: Profile, target: str, folder: Path, url: str, *, tenant: str = "", authority: str = ""
    ) -> None:
        self.profile = profile
        self.folder = folder
        self.creating: set[str] = set()
        self._target, self._tenant = target.rstrip("/"), tenant
        self._file = folder / "strict-broker.json"
        self.state: dict[str, Any] = {"spoiled": []}
        if self._file.exists():
            self.state = json.loads(self._file.read_text())
        files = (Path(authority),) if authority else ()
        self._streams = StreamingHttpClient(ca_files=files)
        self._http = BodyReadingHttpClient(ca_files=files)
        is_checked = "context-version" in profile.rules
        self._contexts = StoredContexts(self.state, self.save, self._http, url, is_checked=is_checked)

    def save(self) -> None:
        new = self._file.with_suffix(".new")
        new.touch(mode=0o600)
        new.write_text(json.dumps(self.state))
        new.replace(self._file)

    def close(self) -> None:
        self._streams.close()
        self._http.close()

    async def ask(self, method: str, target: str, headers: list[tuple[str, str]]) -> Any:
        return await self._http.request(method, self._target + target, headers, b"", TIMEOUT_S)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        assert scope["type"] == "http"
        request = Request(scope, receive)
        response: Response
        try:
            response = await self._answered(request)
        except Refused as refused:
            answer = refused.answer
            headers = dict(answer.headers or {})
            if tenant := request.headers.get("ngsild-tenant"):
                headers["NGSILD-Tenant"] = tenant
            if answer.body is None:
                response = Response(status_code=answer.status)
            else:
                response = JSONResponse(answer.body, answer.status)
            response.headers.update(headers)
        except SendError as error:
            response = JSONResponse(problem(503, "Service Unavailable", str(error)).body, 503)
        await response(scope, receive, send)

    async def _answered(self, request: Request) -> Response:
        path = unquote(request.scope["raw_path"].decode().partition("?")[0])
        if path.startswith(CONTEXTS):
            return JSONResponse(self._contexts.copy(path))
        if path == "/ngsi-ld/ex/v1/version" and self.profile.version is not None:
            return JSONResponse(dict(self.profile.version))
        given = request.headers.get("ngsild-tenant", "")
        call = ProxiedCall(
            self,
            "GET" if request.method == "HEAD" else request.method,
            path.removeprefix(API),
            dict(parse_qsl(request.url.query, keep_blank_values=True)),
            {name: value for name, value in request.headers.items() if name not in OWN_HEADERS},
            "_".join(filter(None, (self._tenant, given.replace("-", "_")))) if self._tenant else given,
            await request.body(),
        )
        params = dict(call.params)
        before = json.dumps(call.body)
        if "context-cache" in self.profile.rules:
            if call.method == "DELETE" and call.params.get("reload") == "true":
                await self._contexts.reload(call.path.removeprefix("jsonldContexts/"))
                raise Refused(Answer(204))
            await self._contexts.replace(call.headers, call.body)
        for rule in (rule for name, rule in RULES.items() if name in self.profile.rules):
            if (answer := await rule.check(call)) is not None:
                raise Refused(answer)
        place = call.path.split("/")
        if call.entities and len(place) == 4:
            call.body = call.entities[0][place[3]]
        query = request.url.query if params == call.params else urlencode(call.params)
        body = call.raw if before == json.dumps(call.body) else json.dumps(call.body).encode()
        target = request.scope["raw_path"].decode().partition("?")[0] + (f"?{query}" if query else "")
        new = {one["id"] for one in call.entities if call.path == "entities" and "id" in one}
        self.creating |= new
        try:
            return await self._forwarded(call, target, body, given)
        finally:
            self.creating -= new

    async def _forwarded(self, call: ProxiedCall, target: str, body: bytes, tenant: str) -> Response:
        if call.is_done:
            return self._changed(call, 204, b"", {})
        reply = await self._streams.stream(
            call.method, self._target + target, call.out(call.headers), body, TIMEOUT_S
        )
        headers = {name.decode(): value.decode("latin-1") for name, value in reply.headers}
        headers = {name.lower(): value for name, value in headers.items() if name.lower() not in OWN_HEADERS}
        if "ngsild-tenant" in headers:
            headers["ngsild-tenant"] = tenant
        if "link" in headers:
            headers["link"] = self._contexts.restore(headers["link"])
        names_contexts = "ld+json" in headers.get("content-type", "") or call.path.startswith("subscriptions")
        if not call.changes and not names_contexts:
            return StreamingResponse(_chunks(reply), reply.status, headers)
        text = b"".join([chunk async for chunk in _chunks(reply)])
        return self._changed(call, reply.status, self._contexts.restore(text.decode()).encode(), headers)

    @staticmethod
    def _changed(call: ProxiedCall, status: int, body: bytes, headers: dict[str, str]) -> Response:
        for change in call.changes:
            status, body = change(status, body)
        if body:
            headers = {"content-type": "application/json", **headers}
        return Response(body, status, headers)


async def _chunks(reply: StreamedResponse) -> AsyncIterator[bytes]:
    try:
        async for chunk in reply.chunks(TIMEOUT_S):
            yield chunk
    finally:
        reply.close()


def main() -> None:
    """Serve with the settings in the environment, and over TLS with the certificate of the services.

    The process ends when its standard input ends.
    """
    given = os.environ
    port, certificate = int(given["STRICT_BROKER_PORT"]), given.get("HANDOVER_TLS_CERTIFICATE")
    broker = StrictBroker(
        profile_of(given["STRICT_BROKER_PROFILE"]),
        given["STRICT_BROKER_TARGET"],
        Path(given["STRICT_BROKER_FOLDER"]),
        f"{'https' if certificate else 'http'}://127.0.0.1:{port}",
        tenant=given.get("STRICT_BROKER_TENANT", ""),
        authority=given.get("HANDOVER_TLS_AUTHORITY", ""),
    )
    threading.Thread(target=_end_with_input, daemon=True).start()
    uvicorn.run(
        broker,
        port=port,
        lifespan="off",
        log_level="warning",
        ssl_certfile=certificate,
        ssl_keyfile=given.get("HANDOVER_TLS_KEY"),
        timeout_keep_alive=75,
    )


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    main()
