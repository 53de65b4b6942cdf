"""Alerts of the broker reach a real mail server and a real webhook, once, also if servers hang."""

import asyncio
import hashlib
import hmac
import json
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from typing import Any

import httpx
import pytest
from aiosmtpd.smtp import SMTP
from fastapi import FastAPI
from pydantic import SecretStr
from starlette.requests import Request

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import DEVICE_ANOMALY
from handover.broker import BrokerClient
from handover.database import connect
from handover_alerts.app import make_app
from handover_alerts.model.configuration import AppriseChannel, MailChannel, Throttle, WebhookChannel
from handover_alerts.senders import NotSent, Outgoing, Senders
from handover_alerts.sending import Sending
from handover_alerts.settings import RouterSettings
from handover_alerts.storage import tables
from handover_alerts.storage.store import Message as LogMessage
from handover_alerts.storage.store import Store
from tests.kit.cell import Cell
from tests.kit.certificates import Certificates
from tests.kit.device_gateways import background
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

SECRET = "a-secret-of-the-receiver"


class Mailbox:
    """A mail server that keeps what it accepts; it refuses mails to `refused@…`."""

    def __init__(self) -> None:
        self.mails: list[Message] = []

    async def handle_RCPT(  # noqa: N802 - the name of the hook
        self, server: Any, session: Any, envelope: Any, address: str, options: Any
    ) -> str:
        if address.startswith("refused@"):
            return "550 no such user"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
        self.mails.append(message_from_bytes(envelope.content))
        return "250 OK"

    def subjects(self) -> list[str]:
        return [str(mail["Subject"]) for mail in self.mails]


@pytest.fixture
async def mailbox() -> AsyncIterator[tuple[Mailbox, int]]:
    box = Mailbox()
    server = await asyncio.get_running_loop().create_server(
        lambda: SMTP(box, loop=asyncio.get_running_loop()), "127.0.0.1", 0
    )
    async with server:
        yield box, server.sockets[0].getsockname()[1]


@asynccontextmanager
async def running(cell: Cell, folder: Path, **members: Any) -> AsyncIterator[httpx.AsyncClient]:
    """Run the real application in this process, with a client of its REST interface."""
    settings = RouterSettings.load(
        broker_url=cell.url("context_broker"),
        broker_tenant=cell.tenant or None,
        data_dir=folder,
        reconcile_s=1,
        **members,
    )
    app = make_app(settings)
    transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as rest,
    ):
        yield rest


async def log_of(rest: httpx.AsyncClient, **filters: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = (await rest.get("/messages", params=filters)).raise_for_status().json()
    return found


@pytest.mark.nightly
async def test_alerts_are_sent_once_by_mail_and_webhook_and_a_hanging_server_delays_nothing(
    shared_cell: Cell, tmp_path: Path, mailbox: tuple[Mailbox, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover_alerts.senders.SEND_TIMEOUT_S", 2.0)
    shared_cell.run("context_broker")
    box, port = mailbox
    received: list[tuple[dict[str, str], bytes]] = []
    hook_port = next_free_port()
    hanging = socket.create_server(("127.0.0.1", 0))  # accepts connections and never answers
    members = {"smtp_url": f"smtp://127.0.0.1:{port}"}

    async with receiver(hook_port, received), running(shared_cell, tmp_path, **members) as rest:
        for name, channel in (
            ("ops", {"type": "mail", "to": ["ops@example.org"]}),
            ("wrong", {"type": "mail", "to": ["refused@example.org"]}),
            ("hook", {"type": "webhook", "url": f"http://127.0.0.1:{hook_port}/in", "secret": SECRET}),
            ("hangs", {"type": "webhook", "url": f"http://127.0.0.1:{hanging.getsockname()[1]}/"}),
        ):
            (await rest.put(f"/channels/{name}", json=channel)).raise_for_status()
        route = {
            "channels": ["hangs", "ops", "hook", "wrong"],
            "minimumSeverity": "medium",
            "escalations": [{"afterS": 0.5, "channels": ["ops"]}],
        }
        (await rest.put("/routes/all", json=route)).raise_for_status()
        async with BrokerClient(shared_cell.settings) as broker:
            await _raise(broker, shared_cell, "hot")
            await until(lambda: len(box.mails) == 2 and received)
            assert [subject.partition("[")[0] for subject in box.subjects()] == ["", "Not acknowledged: "]
            assert "too hot" in str(box.mails[0].get_payload())
            headers, body = received[0]
            signature = hmac.new(SECRET.encode(), body, hashlib.sha256).hexdigest()
            assert headers["handover-signature"] == f"sha256={signature}"
            assert json.loads(body)["alerts"][0]["severity"] == "medium"
            (failed,) = await until(lambda: log_of(rest, state="failed"))
            assert (failed["channel"], "refuses" in failed["error"]) == ("wrong", True)
            (waiting,) = await until(lambda: _tried(rest))
            assert (waiting["channel"], "no answer" in waiting["error"]) == ("hangs", True)
            await clear_alert(broker, shared_cell.settings, key="hot")
            await until(lambda: len(box.mails) == 3)
            assert box.subjects()[2].startswith("Returned to normal: ")
        assert (await rest.put("/routes/x", json={"channels": ["no"]})).json()[
            "detailCode"
        ] == "alert_router.unknown"
        assert (await rest.delete("/channels/ops")).json()["detailCode"] == "alert_router.channel_in_use"
        messenger = {"type": "apprise", "url": "json://127.0.0.1"}
        refused = await rest.put("/channels/m", json=messenger)
        assert refused.json()["detailCode"] == "alert_router.apprise_in_file"
        assert SECRET not in (await rest.get("/channels")).text
        tested = (await rest.post("/channels/ops/test")).json()
        assert tested == {"sent": True, "reason": None}
        assert not (await rest.post("/channels/hangs/test")).json()["sent"]
        example = {"severity": "low"}
        assert (await rest.post("/routes/test", json=example)).json() == []
    hanging.close()
    async with running(shared_cell, tmp_path, **members) as rest:  # another run knows what was sent
        assert {one["name"] for one in (await rest.get("/channels")).json()} == {
            "ops",
            "wrong",
            "hook",
            "hangs",
        }
        await until(lambda: _has_looked(rest))
        assert len(box.mails) == 4


@pytest.mark.nightly
async def test_many_alerts_are_sent_together(
    shared_cell: Cell, tmp_path: Path, mailbox: tuple[Mailbox, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover_alerts.senders.SEND_TIMEOUT_S", 2.0)
    shared_cell.run("context_broker")
    box, port = mailbox
    file = tmp_path / "routes.yaml"
    file.write_text(
        "channels:\n  ops: {type: mail, to: [ops@example.org], throttle: {maximum: 2, perS: 5}}\n"
        "routes:\n  all: {channels: [ops], sendCleared: false, sources: ['*:oven-9']}\n"
    )
    members = {"smtp_url": f"smtp://127.0.0.1:{port}", "alert_routes": file}
    async with BrokerClient(shared_cell.settings) as broker:
        for number in range(30):
            await _raise(broker, shared_cell, f"many-{number}", source="oven-9")
        async with running(shared_cell, tmp_path, **members) as rest:
            await until(lambda: _all_sent(rest, 30))
            assert len(box.mails) < 30
            text = "".join(str(mail.get_payload()) for mail in box.mails)
            assert all(f"many-{number} is too hot" in text for number in range(30))
            assert (await rest.delete("/routes/all")).json()["detailCode"] == "alert_router.in_file"


async def _raise(broker: BrokerClient, cell: Cell, key: str, source: str = "oven-1") -> None:
    await raise_alert(
        broker,
        cell.settings,
        DEVICE_ANOMALY,
        key=key,
        source=f"urn:ngsi-ld:Device:demo:{source}",
        description=f"{key} is too hot",
    )


async def _tried(rest: httpx.AsyncClient) -> list[dict[str, Any]]:
    found = await log_of(rest, state="waiting")
    return found if [one["channel"] for one in found] == ["hangs"] and found[0]["attempts"] else []


async def _has_looked(rest: httpx.AsyncClient) -> bool:
    """Return whether the message to the server that has ended was tried again."""
    return any(one["attempts"] > 1 for one in await log_of(rest) if one["channel"] == "hangs")


async def _all_sent(rest: httpx.AsyncClient, count: int) -> bool:
    return len(await log_of(rest, state="sent")) == count


@asynccontextmanager
async def receiver(port: int, received: list[tuple[dict[str, str], bytes]]) -> AsyncIterator[None]:
    """Run a web server that keeps what is posted to it."""
    import uvicorn

    app = FastAPI()

    @app.post("/in")
    async def accept(request: Request) -> None:
        received.append((dict(request.headers), await request.body()))

    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error", lifespan="off"))
    task = asyncio.create_task(server.serve())
    await until(lambda: server.started)
    yield
    server.should_exit = True
    await task


async def test_the_allowance_of_a_channel_survives_a_restart(tmp_path: Path) -> None:
    now = 1_800_000_000.0
    channel = WebhookChannel(url="https://desk.example", throttle=Throttle(maximum=2, per_s=60))

    class Recording:
        """Stands at the border: what would go over the network."""

        def __init__(self) -> None:
            self.sent: list[Outgoing] = []

        async def send(self, _: Any, outgoing: Outgoing) -> None:
            self.sent.append(outgoing)

    @asynccontextmanager
    async def run_of(database: Path) -> AsyncIterator[tuple[Store, Recording]]:
        engine = connect(f"sqlite:///{database}")
        tables.prepare(engine)
        store, border = Store(engine), Recording()
        sending = Sending(store, border, lambda _: channel, lambda: now)  # type: ignore[arg-type]
        async with background(sending.run):
            yield store, border
        engine.dispose()

    def waiting(number: int) -> LogMessage:
        return LogMessage("urn:a", "all", "raised", "desk", f"{number}", '{"text": "x"}', int(now * 1e6))

    async with run_of(tmp_path / "a.sqlite") as (store, border):
        for number in range(2):
            store.add(waiting(number))
            await until(lambda number=number: len(border.sent) == number + 1 and not store.waiting("desk", 9))
            now += 1
    async with run_of(tmp_path / "a.sqlite") as (store, border):
        store.add(waiting(3))
        await until(lambda: store.waiting_channels() == {"desk": 1})
        store.add(waiting(4))
        assert not border.sent  # two of two were sent within the minute, by the run before
        now += 60
        await until(lambda: not store.waiting("desk", 9))
        assert [len(one.alerts) for one in border.sent] in ([2], [1, 1])


async def test_mail_by_starttls_is_verified_and_a_hanging_server_is_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = Certificates(tmp_path / "c").make("127.0.0.1", "localhost")
    box, context = Mailbox(), ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(files.certificate, files.key)
    loop = asyncio.get_running_loop()
    server = await loop.create_server(
        lambda: SMTP(box, loop=loop, tls_context=context, require_starttls=True), "127.0.0.1", 0
    )
    hanging = socket.create_server(("127.0.0.1", 0))  # accepts connections and never greets
    channel, message = MailChannel(to=("ops@example.org",)), Outgoing("1", "Hot", "too hot", [{}])
    async with server:
        url = f"smtp://localhost:{server.sockets[0].getsockname()[1]}"
        trusting = Senders(RouterSettings.load(smtp_url=url, tls_authority=files.authority))
        await trusting.send(channel, message)
        assert box.subjects() == ["Hot"]
        with pytest.raises(NotSent, match=r"(?i)certificate"):
            await Senders(RouterSettings.load(smtp_url=url)).send(channel, message)
        silent = f"smtp://127.0.0.1:{hanging.getsockname()[1]}"
        monkeypatch.setattr("handover_alerts.senders.SEND_TIMEOUT_S", 0.3)
        with pytest.raises(NotSent, match=r"(?i)no answer|timed? ?out"):
            await Senders(RouterSettings.load(smtp_url=silent)).send(channel, message)
    hanging.close()
    assert len(box.mails) == 1


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:.*imghdr:DeprecationWarning")  # a plugin of Apprise imports it
async def test_apprise_sends_to_a_receiver_by_its_json_url() -> None:
    received: list[tuple[dict[str, str], bytes]] = []
    port = next_free_port()
    async with receiver(port, received):
        channel = AppriseChannel(url=SecretStr(f"json://127.0.0.1:{port}/in"))
        await Senders(RouterSettings.load()).send(channel, Outgoing("1", "Hot", "too hot", [{}]))
        document = json.loads(received[0][1])
        assert (document["title"], document["message"]) == ("Hot", "too hot")
    with pytest.raises(NotSent, match="did not accept"):  # nobody listens any more
        await Senders(RouterSettings.load()).send(channel, Outgoing("2", "Hot", "too hot", [{}]))


@pytest.mark.nightly
async def test_no_mail_is_lost_or_sent_more_than_twice_when_the_router_is_killed(
    shared_cell: Cell, mailbox: tuple[Mailbox, int], tmp_path: Path
) -> None:
    shared_cell.run("context_broker")
    box, port = mailbox
    file = tmp_path / "routes.yaml"
    file.write_text(
        "channels:\n  ops: {type: mail, to: [ops@example.org], throttle: {maximum: 1000, perS: 60}}\n"
        "routes:\n  all: {channels: [ops], sendCleared: false, sources: ['*:oven-killed']}\n"
    )
    shared_cell.extra |= {"HANDOVER_SMTP_URL": f"smtp://127.0.0.1:{port}", "HANDOVER_ALERT_ROUTES": str(file)}
    if shared_cell.runs("alert_router"):
        await asyncio.to_thread(shared_cell.kill, "alert_router")
    await asyncio.to_thread(shared_cell.start, "alert_router")
    names = [f"killed-{number}" for number in range(20)]
    async with BrokerClient(shared_cell.settings) as broker:
        for name in names[:10]:
            await _raise(broker, shared_cell, name, source="oven-killed")
        await until(lambda: len(box.mails) >= 3)
        await asyncio.to_thread(shared_cell.kill, "alert_router")
        for name in names[10:]:
            await _raise(broker, shared_cell, name, source="oven-killed")
        await asyncio.to_thread(shared_cell.start, "alert_router")
        url = f"{shared_cell.url('alert_router')}/messages"
        async with httpx.AsyncClient(trust_env=False, timeout=60) as rest:

            async def log() -> list[dict[str, Any]]:
                found = (await rest.get(url, params={"limit": 1000})).json()
                return [one for one in found if "oven-killed" in one["subject"]]

            await until(lambda: _all_of(log, len(names)))
            assert len(await log()) == len(names)  # each step was stored once
    await asyncio.to_thread(shared_cell.kill, "alert_router")
    for name in ("HANDOVER_SMTP_URL", "HANDOVER_ALERT_ROUTES"):
        del shared_cell.extra[name]
    texts = [str(mail.get_payload()) for mail in box.mails]
    copies = [sum(f"{name} is too hot" in text for text in texts) for name in names]
    # At least once; only the mail that was under way at that moment may come twice, with the same id.
    assert min(copies) == 1
    assert sum(copies) <= len(names) + 1
    ids = [str(mail["Message-ID"]) for mail in box.mails]
    assert len(ids) - len(set(ids)) <= 1


async def _all_of(log: Any, count: int) -> bool:
    return sum(one["state"] == "sent" for one in await log()) == count
