"""Streams of an on-demand source: one WebSocket for each followed resource, against a real server."""

from pathlib import Path
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve

from handover.security.service_access import ServiceAccess
from handover.settings import Settings
from handover_web.sources.on_demand import Streams
from tests.kit.waiting import until

HOST = "127.0.0.1"


def port_of(server: Server) -> int:
    return int(next(iter(server.sockets)).getsockname()[1])


class Recorder:
    """What a `Streams` reports."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, Any]] = []
        self.ended: list[str] = []

    def streams(self, port: int) -> Streams:
        return Streams(
            lambda name: f"ws://{HOST}:{port}/{name}",
            lambda name, message: self.messages.append((name, message)),
            self.ended.append,
            access=ServiceAccess(Settings(data_dir=Path("without-accounts"), _env_file=None), "webui"),
        )


async def send_and_close(socket: ServerConnection) -> None:
    await socket.send('{"path": "%s"}' % (socket.request.path if socket.request else ""))


async def send_and_stay(socket: ServerConnection) -> None:
    await send_and_close(socket)
    await socket.wait_closed()


async def test_a_closed_stream_is_connected_again() -> None:
    seen = Recorder()
    async with serve(send_and_close, HOST, 0) as server, seen.streams(port_of(server)) as streams:
        await streams.follow({"a"})
        await until(lambda: len(seen.messages) >= 3)
        assert streams.names == {"a"}
    assert set(map(str, seen.messages)) == {"('a', {'path': '/a'})"}
    assert len(seen.ended) >= 2


async def test_only_the_named_resources_are_followed() -> None:
    seen = Recorder()
    async with serve(send_and_stay, HOST, 0) as server, seen.streams(port_of(server)) as streams:
        await streams.follow({"a", "b"})
        await until(lambda: {name for name, _ in seen.messages} == {"a", "b"})
        await streams.follow({"b", "c"})
        assert streams.names == {"b", "c"}
        assert seen.ended == ["a"]
        await until(lambda: {name for name, _ in seen.messages} == {"a", "b", "c"})
    assert sorted(seen.ended) == ["a", "b", "c"]


async def test_a_stream_is_connected_again_after_an_invalid_message() -> None:
    seen = Recorder()
    answers = iter(["no json", '"fine"'])

    async def send_next(socket: ServerConnection) -> None:
        await socket.send(next(answers))
        await socket.wait_closed()

    async with serve(send_next, HOST, 0) as server, seen.streams(port_of(server)) as streams:
        await streams.follow({"a"})
        await until(lambda: seen.messages)
    assert seen.messages == [("a", "fine")]


async def test_nothing_is_followed_after_the_end() -> None:
    seen = Recorder()
    async with serve(send_and_stay, HOST, 0) as server:
        streams = seen.streams(port_of(server))
        async with streams:
            await streams.follow({"a"})
            await until(lambda: seen.messages)
        await streams.follow({"a", "b"})
        await until(lambda: not streams.names)
    assert seen.messages == [("a", {"path": "/a"})]
