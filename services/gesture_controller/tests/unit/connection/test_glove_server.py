"""The glove server acknowledges hellos, refuses or drops invalid lines, and keeps serving."""

import asyncio
import resource
import tracemalloc
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import orjson
import pytest
from sqlalchemy import Engine

from handover.errors import UsageError
from handover.security.access_tokens import SigningKey, key_set
from handover.security.glove_token import GLOVE_TOKEN_FILE, make_glove_token, site_glove_token
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover_gloves.calibration.glove_store import GloveStore
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.connection.admission import TokenStore
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.connection.glove_server import HELLO_TIMEOUT_S, MAX_WAITING_FOR_HELLO, GloveServer
from handover_gloves.gloves import connection_state
from handover_gloves.people.people import People
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.recognition.frames import MAX_LINE_BYTES
from handover_gloves.settings import ControllerSettings
from tests.kit.waiting import until

HELLO: dict[str, Any] = {"type": "hello", "version": 1, "glove": "glove-1", "hand": "right"}
FRAME = b'{"type":"frame","seq":1,"t":%f,"bend":[700,300,300,300,300]}\n'
WITHIN_S = 120.0

Open = Callable[..., Any]


class Line:
    """A TCP connection to the controller, as a glove's bridge has it."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    async def say(self, what: dict[str, Any] | bytes) -> None:
        self.writer.write(what if isinstance(what, bytes) else orjson.dumps(what) + b"\n")
        await self.writer.drain()

    async def receive(self) -> dict[str, Any] | None:
        """Return the next line, None at the end."""
        async with asyncio.timeout(WITHIN_S):
            line = await self.reader.readline()
        return orjson.loads(line) if line else None

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return  # the other side was quicker


class Site:
    """A glove server with its gloves, and lines to it."""

    def __init__(self, settings: ControllerSettings, gloves: GloveRegistry, server: GloveServer) -> None:
        self.settings = settings
        self.gloves = gloves
        self.server = server
        self.lines: list[Line] = []

    async def connect(self, hello: dict[str, Any] | None = None) -> Line:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.settings.glove_port)
        line = Line(reader, writer)
        self.lines.append(line)
        if hello is not None:
            await line.say(hello)
        return line

    async def until(self, condition: Callable[[], object]) -> None:
        await until(condition)


OpenSite = Callable[..., Awaitable[Site]]


@pytest.fixture
async def open_site(
    tmp_path: Path, database: Engine, listener_log: Any, free_port: Callable[[], int]
) -> AsyncIterator[OpenSite]:
    """Open a glove server; settings may be given."""
    async with AsyncExitStack() as stack:

        async def begin(hello_timeout_s: float = HELLO_TIMEOUT_S, **overrides: Any) -> Site:
            settings = ControllerSettings.load(glove_port=free_port(), data_dir=tmp_path, **overrides)
            people = People(built_in(), PeopleStore(database))
            gloves = GloveRegistry(
                settings,
                store=GloveStore(database),
                tokens=TokenStore(database),
                people=people,
                conditions=StudyConditionStore(database),
                listener=listener_log,
                adopted=lambda _: None,
            )
            server = await stack.enter_async_context(
                GloveServer(settings, gloves, hello_timeout_s=hello_timeout_s)
            )
            site = Site(settings, gloves, server)
            stack.push_async_callback(_hang_up, site)
            return site

        yield begin


async def _hang_up(site: Site) -> None:
    for line in site.lines:
        await line.close()
    await site.until(lambda: not site.server.open)


async def test_a_hello_is_acknowledged_and_frames_are_taken(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    assert await line.receive() == {"type": "ack", "version": 1, "glove": "glove-1"}
    for count in range(100):
        await line.say(FRAME % (count / 50))
    glove = site.gloves.known.named("glove-1")
    await site.until(lambda: glove.connection.traffic.frames == 100)
    assert glove.is_connected
    assert glove.reader.state.gesture is None  # the thresholds shipped read 700 of a thumb as bent
    await line.close()
    await site.until(lambda: not glove.is_connected)


async def test_a_glove_nobody_knew_is_taken_in(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect({**HELLO, "glove": "glove-7", "hand": "left"})
    assert (await line.receive() or {})["type"] == "ack"
    assert site.gloves.known.named("glove-7").hand == "left"


async def test_frames_in_pieces_and_in_bundles_are_read_alike(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    glove = site.gloves.known.named("glove-1")
    stream = b"".join(FRAME % (count / 50) for count in range(20))
    for at in range(0, len(stream), 7):
        await line.say(stream[at : at + 7])
        await asyncio.sleep(0)
    await site.until(lambda: glove.connection.traffic.frames == 20)
    await line.say(stream + stream)
    await site.until(lambda: glove.connection.traffic.frames == 60)
    assert not glove.connection.traffic.dropped


async def test_a_half_frame_at_the_end_of_a_connection_is_no_frame(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    await line.say(FRAME % 1.0 + b'{"type":"frame","t":1.02,"ben')
    glove = site.gloves.known.named("glove-1")
    await site.until(lambda: glove.connection.traffic.frames == 1)
    await line.close()
    await site.until(lambda: glove.connection.link is None)
    again = await site.connect(HELLO)
    await again.receive()
    await again.say(FRAME % 2.0)
    await site.until(lambda: glove.connection.traffic.frames == 2)
    assert not glove.connection.traffic.dropped


async def test_bad_lines_are_counted_by_reason_and_good_ones_go_on(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    await line.say(b"garbage\n\n\r\n")
    await line.say(b'{"type":"frame","t":1,"bend":[1,2,NaN,4,5]}\n')
    await line.say(b'{"type":"frame","t":1,"bend":[1,2,3]}\n')
    await line.say(b'{"type":"frame","t":1,"bend":[1,2,3,4,"5"]}\n')
    await line.say(HELLO)
    await line.say(FRAME % 1.0)
    glove = site.gloves.known.named("glove-1")
    await site.until(lambda: glove.connection.traffic.frames == 1)
    reasons = {"not JSON": 2, "missing fingers": 1, "not a number": 1, "not a frame": 1}
    assert glove.connection.traffic.dropped == reasons


async def test_a_ten_megabyte_line_is_refused_and_does_not_grow_memory(open_site: OpenSite) -> None:
    site = await open_site()
    working = await site.connect({**HELLO, "glove": "working"})
    await working.receive()
    line = await site.connect(HELLO)
    await line.receive()
    megabyte = b"x" * 1_000_000
    tracemalloc.start()
    try:
        for _ in range(10):
            await line.say(megabyte)
        answer = await line.receive()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert answer == {
        "type": "error",
        "reason": "a line holds at most 65536 bytes, end each with a newline",
        "retry": True,
    }
    assert peak < 5_000_000  # what the sender itself has in flight included
    assert await line.receive() is None
    await working.say(FRAME % 1.0)
    await site.until(lambda: site.gloves.known.named("working").connection.traffic.frames == 1)


async def test_a_long_line_with_an_end_is_refused_too(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    await line.say(b"x" * (MAX_LINE_BYTES + 1) + b"\n")
    assert (await line.receive() or {})["type"] == "error"


async def test_a_line_of_just_the_limit_is_read(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    await line.say(b"x" * MAX_LINE_BYTES + b"\n" + FRAME % 1.0)
    glove = site.gloves.known.named("glove-1")
    await site.until(lambda: glove.connection.traffic.frames == 1)
    assert glove.connection.traffic.dropped == {"not JSON": 1}


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (b"GET / HTTP/1.1\r\n", "not JSON; send a hello first"),
        (FRAME % 1.0, "not a hello"),
        (orjson.dumps({**HELLO, "sensors": ["thumb"]}) + b"\n", "index, middle, ring, little missing"),
        (b"x" * 70_000, "at most 65536 bytes"),
    ],
)
async def test_a_connection_without_a_hello_gets_the_reason_and_is_closed(
    open_site: OpenSite, first: bytes, words: str
) -> None:
    site = await open_site()
    line = await site.connect()
    await line.say(first)
    answer = await line.receive() or {}
    assert answer["type"] == "error"
    assert words in answer["reason"]
    assert await line.receive() is None


async def test_a_silent_connection_is_closed(open_site: OpenSite) -> None:
    site = await open_site(hello_timeout_s=0.05)
    line = await site.connect()
    assert await line.receive() == {"type": "error", "reason": "no hello within 0.05 s", "retry": True}
    assert await line.receive() is None
    slow_but_there = await site.connect(HELLO)
    assert (await slow_but_there.receive() or {})["type"] == "ack"
    await site.until(lambda: not site.server.waiting)
    await slow_but_there.say(FRAME % 1.0)
    await site.until(lambda: site.gloves.known.named("glove-1").connection.traffic.frames == 1)


async def test_a_wrong_token_is_refused(open_site: OpenSite) -> None:
    site = await open_site(glove_token="open sesame")
    for token in ("open barley", "", "open sesame ", "öffne dich"):
        line = await site.connect({**HELLO, "token": token})
        answer = await line.receive() or {}
        assert answer["type"] == "error"
        assert "the token is wrong" in answer["reason"]
        assert answer["retry"] is False
        assert "sesame" not in answer["reason"]
    line = await site.connect({**HELLO, "token": "open sesame"})
    assert (await line.receive() or {})["type"] == "ack"


async def test_a_connection_in_use_keeps_its_glove(
    open_site: OpenSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        connection_state, "TAKEOVER_SILENCE_S", 1e9
    )  # else a slow machine would count as silence
    site = await open_site()
    older, newer = await site.connect(HELLO), await site.connect(HELLO)
    await older.receive()
    refused = await newer.receive() or {}
    assert "another connection of glove-1 is in use; end it, or connect again" in refused["reason"]
    assert refused["retry"] is True
    assert await newer.receive() is None
    await older.say(FRAME % 1.0)
    await site.until(lambda: site.gloves.known.named("glove-1").connection.traffic.frames == 1)


async def test_a_connection_that_was_silent_gives_way(
    open_site: OpenSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_state, "TAKEOVER_SILENCE_S", 0.0)
    site = await open_site()
    older, newer = await site.connect(HELLO), await site.connect()
    await older.receive()
    await newer.say(HELLO)
    assert (await newer.receive() or {})["type"] == "ack"
    assert "since this connection was silent" in (await older.receive() or {})["reason"]
    assert await older.receive() is None
    await newer.say(FRAME % 1.0)
    await site.until(lambda: site.gloves.known.named("glove-1").connection.traffic.frames == 1)


async def test_a_glove_with_a_token_of_its_own_connects_with_it_only(open_site: OpenSite) -> None:
    site = await open_site(glove_token="open sesame")
    before = await site.connect({**HELLO, "token": "open sesame"})
    assert (await before.receive() or {})["type"] == "ack"
    token = await site.gloves.set_token("glove-1")
    assert "the token of glove-1 was changed" in (await before.receive() or {})["reason"]
    assert await before.receive() is None
    await site.until(lambda: site.gloves.known.named("glove-1").connection.link is None)
    for wrong in ("open sesame", "", token + "x"):
        line = await site.connect({**HELLO, "token": wrong})
        answer = await line.receive() or {}
        assert "glove-1 has a token of its own" in answer["reason"]
        assert "handover glove token glove-1" in answer["reason"]
        assert answer["retry"] is False
        assert token not in answer["reason"]
    line = await site.connect({**HELLO, "token": token})
    assert (await line.receive() or {})["type"] == "ack"
    other = await site.connect({**HELLO, "glove": "other", "token": "open sesame"})
    assert (await other.receive() or {})["type"] == "ack"


async def test_beyond_loopback_every_glove_needs_a_token(open_site: OpenSite) -> None:
    site = await open_site(glove_host="0.0.0.0")
    line = await site.connect(HELLO)
    answer = await line.receive() or {}
    assert "glove-1 has no token, and others can reach this port; make one with" in answer["reason"]
    assert answer["retry"] is False
    token = await site.gloves.set_token("glove-1")
    line = await site.connect({**HELLO, "token": token})
    assert (await line.receive() or {})["type"] == "ack"


async def test_with_accounts_every_glove_needs_a_token_also_on_loopback(
    open_site: OpenSite, tmp_path: Path
) -> None:
    security = tmp_path / "security"
    site = await open_site(security_dir=security)
    before = await site.connect({**HELLO, "glove": "before"})
    assert (await before.receive() or {})["type"] == "ack", "in local mode none is needed"
    make_glove_token(security)
    (security / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))
    wrong = await site.connect(HELLO)
    assert "the token is wrong" in (await wrong.receive() or {})["reason"]
    line = await site.connect({**HELLO, "token": site_glove_token(None, security)})
    assert (await line.receive() or {})["type"] == "ack"
    (security / GLOVE_TOKEN_FILE).unlink()

    async def is_refused() -> bool:
        """The keys are read again within a second."""
        answer = await (await site.connect({**HELLO, "glove": "other"})).receive() or {}
        return "with accounts every glove has one" in answer.get("reason", "")

    await until(is_refused)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("has_site_token", "why"), [(True, "the token is wrong"), (False, "with accounts every glove has one")]
)
async def test_accounts_that_are_set_up_later_end_the_connections_without_a_token(
    open_site: OpenSite, tmp_path: Path, has_site_token: bool, why: str
) -> None:
    security = tmp_path / "security"
    site = await open_site(security_dir=security)
    own = await site.gloves.set_token("glove-2")
    lines = [await site.connect(HELLO), await site.connect({**HELLO, "glove": "glove-2", "token": own})]
    for line in lines:
        assert (await line.receive() or {})["type"] == "ack"
    waiting = await site.connect()
    if has_site_token:
        make_glove_token(security)
    else:
        security.mkdir()
    (security / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))
    answer = await lines[0].receive() or {}
    assert (answer["type"], answer["retry"]) == ("error", False)
    assert why in answer["reason"]
    assert await lines[0].receive() is None
    await lines[1].say(FRAME % 1.0)
    known = site.gloves.known
    await site.until(lambda: known.named("glove-2").connection.traffic.frames == 1)
    await site.until(lambda: known.named("glove-1").connection.link is None)
    await waiting.say(HELLO)
    assert why in (await waiting.receive() or {})["reason"]


async def test_invented_names_leave_slots_to_gloves_that_are_known(open_site: OpenSite) -> None:
    site = await open_site(max_undeclared_gloves=2, max_gloves=5)
    for name in ("a", "b"):
        line = await site.connect({**HELLO, "glove": name})
        assert (await line.receive() or {})["type"] == "ack"
    refused = await site.connect({**HELLO, "glove": "c"})
    answer = await refused.receive() or {}
    assert "2 gloves that nobody declared are known already" in answer["reason"]
    assert "handover glove token c" in answer["reason"]
    token = await site.gloves.set_token("c")
    for hello in ({**HELLO, "glove": "c", "token": token}, HELLO):
        line = await site.connect(hello)
        assert (await line.receive() or {})["type"] == "ack"


async def test_there_is_an_end_to_new_gloves_but_not_to_known_ones(open_site: OpenSite) -> None:
    site = await open_site(max_gloves=3)
    for name in ("a", "b"):
        line = await site.connect({**HELLO, "glove": name})
        assert (await line.receive() or {})["type"] == "ack"
    refused = await site.connect({**HELLO, "glove": "c"})
    answer = await refused.receive() or {}
    assert "serves 3 gloves at most; raise HANDOVER_MAX_GLOVES" in answer["reason"]
    expected = await site.connect(HELLO)
    assert (await expected.receive() or {})["type"] == "ack"


async def test_when_the_server_stops_gloves_get_the_reason(open_site: OpenSite) -> None:
    site = await open_site()
    line = await site.connect(HELLO)
    await line.receive()
    await site.server.__aexit__()
    assert "the controller stops" in (await line.receive() or {})["reason"]


async def test_a_port_that_is_taken_is_one_line(open_site: OpenSite) -> None:
    site = await open_site()
    with pytest.raises(UsageError, match="set HANDOVER_GLOVE_HOST and HANDOVER_GLOVE_PORT"):
        async with GloveServer(site.settings, site.gloves):
            raise AssertionError("two servers on one port")


@asynccontextmanager
async def many_files() -> AsyncIterator[None]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (before[1], before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


async def test_two_thousand_silent_connections_keep_no_glove_from_working(open_site: OpenSite) -> None:
    async with many_files():
        site = await open_site(hello_timeout_s=60)
        working = await site.connect({**HELLO, "glove": "working"})
        await working.receive()
        glove = site.gloves.known.named("working")
        first = await site.connect()
        for count in range(2000):
            await site.connect()
            await working.say(FRAME % (count / 50))
        assert "connections have sent no hello" in (await first.receive() or {})["reason"]
        await site.until(lambda: glove.connection.traffic.frames == 2000)
        assert len(site.server.waiting) <= MAX_WAITING_FOR_HELLO
        late = await site.connect(HELLO)
        assert (await late.receive() or {})["type"] == "ack"
        await site.until(lambda: len(site.server.open) <= MAX_WAITING_FOR_HELLO + 2)
        assert glove.is_connected
