"""REST of the alert router: channels, routes, the log of messages, and tests of both."""

import asyncio
import time
from datetime import UTC, datetime
from typing import Annotated, Any, Final

import orjson
from fastapi import FastAPI, Query, Request, Response
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.formats.validation import MAX_INTEGER, Moment
from handover.http.body_limit import max_body
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY
from handover_alerts.directory import Directory
from handover_alerts.follower import Follower
from handover_alerts.model.configuration import (
    MAX_CHANNELS,
    MAX_ROUTES,
    AppriseChannel,
    Channel,
    Route,
    WebhookChannel,
    is_name,
)
from handover_alerts.model.occurrence import AlertView, concerns
from handover_alerts.senders import NotSent, Outgoing, Senders
from handover_alerts.storage.store import FAILED, SENT, Message, Store
from handover_datamodels.entities import AlertState, Severity

MAX_BYTES: Final = 64 * 1024
TEST: Final = "test"
CAN_READ = require(Permission.READ)
CAN_SET = require(Permission.MANAGE_SETTINGS)


class ChannelView(TypedDict):
    """A channel; secrets are not shown. One whose `source` is `file` is changed in the file."""

    name: str
    source: str
    channel: Channel
    routes: list[str]


class RouteView(TypedDict):
    """A route."""

    name: str
    source: str
    route: Route


class MessageView(TypedDict):
    """A message about an Alert: `waiting`, `sent` or `failed`."""

    number: int
    alert: str
    route: str
    step: str
    channel: str
    subject: str
    text: str
    createdAt: float
    state: str
    attempts: int
    endedAt: float | None
    error: str | None


class TestResult(TypedDict):
    """What became of a test message."""

    sent: bool
    reason: str | None


class AlertExample(StrictModel):
    """An Alert for which the routes are asked."""

    model_config = ConfigDict(extra="forbid")

    category: str = "device"
    sub_category: str = Field("", alias="subCategory")
    severity: Severity = Severity.MEDIUM
    source: str = Field("", alias="alertSource")
    place: str = ""
    at: Moment | None = None


class RouteAnswer(TypedDict):
    """A route that includes the Alert: whether it is used at that time, and whether it waits."""

    route: str
    channels: list[str]
    open: bool
    quiet: bool


def add_routes(
    app: FastAPI, store: Store, directory: Directory, senders: Senders, follower: Follower
) -> None:
    """Add the routes of the service."""
    _add_channels(app, store, directory, senders)
    _add_alert_routes(app, directory)

    @app.get("/messages", tags=["log"], dependencies=[CAN_READ])
    async def messages(
        before: Annotated[
            int | None, Query(ge=0, le=MAX_INTEGER, description="number of the last message seen")
        ] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
        alert: str | None = None,
        state: str | None = None,
    ) -> list[MessageView]:
        """List what was sent, what waits and what failed, newest first."""
        rows = await asyncio.to_thread(
            lambda: store.log(before=before, limit=limit, alert=alert, state=state)
        )
        return [_message_view(entry) for entry in rows]

    @app.post(
        "/notifications",
        status_code=204,
        tags=["notifications"],
        dependencies=[REQUIRES_NOTIFICATION_KEY],
    )
    async def notify(request: Request) -> Response:
        """Read the Alerts of the broker, since one has changed."""
        await follower.receiver.receive(request)
        follower.resync.request()
        return Response(status_code=204)


def _add_channels(app: FastAPI, store: Store, directory: Directory, senders: Senders) -> None:
    def view(name: str) -> ChannelView:
        source = "file" if name in directory.in_file.channels else "rest"
        return {
            "name": name,
            "source": source,
            "channel": _known_channel(directory, name),
            "routes": directory.users_of(name),
        }

    @app.get("/channels", tags=["channels"], dependencies=[CAN_SET])
    async def channels() -> list[ChannelView]:
        """List the channels by name."""
        return [view(name) for name in sorted(directory.channels)]

    @app.put("/channels/{name}", tags=["channels"], dependencies=[CAN_SET])
    @max_body(MAX_BYTES)
    async def save_channel(
        name: str,
        channel: Channel,
        keep_secret: Annotated[
            bool, Query(alias="keepSecret", description="a webhook without a secret keeps the one it has")
        ] = False,
    ) -> ChannelView:
        """Add or replace a channel."""
        _require_writable(name, in_file=name in directory.in_file.channels)
        if isinstance(channel, AppriseChannel):
            raise Problem.translated(
                422,
                "Only in the file",
                "alert_router.apprise_in_file",
                "a channel of the type apprise can reach any address, so it stands in the file of "
                "HANDOVER_ALERT_ROUTES only",
            )
        _require_not_full(len(directory.channels), MAX_CHANNELS, is_new=name not in directory.channels)
        present = directory.channels.get(name)
        if keep_secret and isinstance(channel, WebhookChannel) and isinstance(present, WebhookChannel):
            channel = channel.model_copy(update={"secret": channel.secret or present.secret})
        await directory.set_channel(name, channel)
        return view(name)

    @app.delete("/channels/{name}", status_code=204, tags=["channels"], dependencies=[CAN_SET])
    async def remove_channel(name: str) -> None:
        """Delete a channel that no route uses."""
        _require_writable(name, in_file=name in directory.in_file.channels)
        _known_channel(directory, name)
        users = directory.users_of(name)
        if users:
            raise Problem.translated(
                409,
                "In use",
                "alert_router.channel_in_use",
                'the route "{route}" uses the channel "{channel}"; change the route first',
                route=users[0],
                channel=name,
            )
        await directory.set_channel(name, None)

    @app.post("/channels/{name}/test", tags=["channels"], dependencies=[CAN_SET])
    async def test_channel(name: str) -> TestResult:
        """Send a test message now, and say whether it was accepted; it is in the log as well."""
        channel = _known_channel(directory, name)
        now = time.time()
        subject, text = "Test of Handover", f'This is a test of the channel "{name}".'
        outgoing = Outgoing(f"handover-test-{int(now * 1e6)}", subject, text, [{"step": TEST, "text": text}])
        reason = None
        try:
            await senders.send(channel, outgoing)
        except NotSent as fault:
            reason = str(fault)
        body = orjson.dumps({"step": TEST, "text": text}).decode()
        now_us = int(now * 1e6)
        entry = Message("", "", TEST, name, subject, body, now_us, state=FAILED)
        number = await asyncio.to_thread(store.add, entry)
        await asyncio.to_thread(store.mark, [number], SENT if reason is None else FAILED, now_us, reason)
        return {"sent": reason is None, "reason": reason}


def _add_alert_routes(app: FastAPI, directory: Directory) -> None:
    def view(name: str) -> RouteView:
        source = "file" if name in directory.in_file.routes else "rest"
        return {"name": name, "source": source, "route": directory.routes[name]}

    @app.get("/routes", tags=["routes"], dependencies=[CAN_READ])
    async def routes() -> list[RouteView]:
        """List the routes by name."""
        return [view(name) for name in sorted(directory.routes)]

    @app.put("/routes/{name}", tags=["routes"], dependencies=[CAN_SET])
    @max_body(MAX_BYTES)
    async def save_route(name: str, route: Route) -> RouteView:
        """Add or replace a route."""
        _require_writable(name, in_file=name in directory.in_file.routes)
        for channel in sorted(route.used_channels()):
            _known_channel(directory, channel, 422)
        _require_not_full(len(directory.routes), MAX_ROUTES, is_new=name not in directory.routes)
        await directory.set_route(name, route)
        return view(name)

    @app.delete("/routes/{name}", status_code=204, tags=["routes"], dependencies=[CAN_SET])
    async def remove_route(name: str) -> None:
        """Delete a route; messages that wait are still sent."""
        _require_writable(name, in_file=name in directory.in_file.routes)
        if name not in directory.routes:
            raise _unknown("route", name, 404)
        await directory.set_route(name, None)

    @app.post("/routes/test", tags=["routes"], dependencies=[CAN_READ])
    @max_body(MAX_BYTES)
    async def test_routes(example: AlertExample) -> list[RouteAnswer]:
        """Return which routes an Alert would take; nothing is sent."""
        now = example.at or datetime.now(UTC)
        alert = AlertView(
            id="",
            category=example.category,
            sub_category=example.sub_category,
            severity=example.severity,
            source=example.source,
            place=example.place,
            description="",
            state=AlertState.NEW,
            issued=now,
            is_active=True,
        )
        return [
            {
                "route": name,
                "channels": list(route.channels),
                "open": route.is_open(now),
                "quiet": route.is_quiet(now, alert.severity),
            }
            for name, route in sorted(directory.routes.items())
            if concerns(route, alert)
        ]


def _known_channel(directory: Directory, name: str, status: int = 404) -> Channel:
    channel = directory.channels.get(name)
    if channel is None:
        raise _unknown("channel", name, status)
    return channel


def _unknown(kind: str, name: str, status: int) -> Problem:
    return Problem.translated(
        status,
        f"No such {kind}",
        "alert_router.unknown",
        'there is no {kind} "{name}"; add it with PUT, or correct the name',
        kind=kind,
        name=name[:64],
    )


def _require_writable(name: str, *, in_file: bool) -> None:
    if in_file:
        raise Problem.translated(
            409,
            "In the file",
            "alert_router.in_file",
            '"{name}" is in the file of HANDOVER_ALERT_ROUTES; change it there and restart the alert '
            "router, or choose another name",
            name=name,
        )
    if not is_name(name):
        raise Problem.translated(
            422,
            "Not a name",
            "alert_router.bad_name",
            '"{name}" cannot be a name here: 1 to 64 letters, digits, "_", "." or "-", a letter or digit '
            "first",
            name=name[:64],
        )


def _require_not_full(count: int, maximum: int, *, is_new: bool) -> None:
    if is_new and count >= maximum:
        raise Problem.translated(
            409,
            "Too many",
            "alert_router.too_many",
            "there are {maximum} already, the maximum; delete one",
            maximum=maximum,
        )


def _message_view(entry: Message) -> MessageView:
    body: dict[str, Any] = orjson.loads(entry.body)
    return {
        "number": entry.id or 0,
        "alert": entry.alert,
        "route": entry.route,
        "step": entry.step,
        "channel": entry.channel,
        "subject": entry.subject,
        "text": str(body.get("text", "")),
        "createdAt": entry.created_us / 1e6,
        "state": entry.state,
        "attempts": entry.attempts,
        "endedAt": None if entry.ended_us is None else entry.ended_us / 1e6,
        "error": entry.error,
    }
