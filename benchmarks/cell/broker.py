"""The embedded broker: one process, a durable store, 16 connections on loopback, Tasks of about 400 bytes.

    python -m benchmarks.cell.broker [--requests 4000] [--rounds 5] [--stored 10000] [--memory 100000]
    python -m benchmarks.cell.broker --url http://127.0.0.1:1027     # any running NGSI-LD broker, empty
    python -m benchmarks.cell.broker --database-url postgresql://…   # ours, in an empty database

Prints creates, patches, retrievals and queries a second (median of the rounds, p50 and p99 of a request),
creates a second also with as many stored as `--memory` says, the time from PATCH to notification, the cold
start and the resident memory; of a broker at `--url` all but the last two. The load generator is a small
client on bare sockets in this process, so that the broker is what is measured.
"""

import argparse
import asyncio
import itertools
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import orjson
import psutil

from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time

CONNECTIONS = 16
MIN_PER_S = {
    "create": 6000,
    "patch": 6000,
    "retrieve": 15000,
    "query, 20 hits": 1500,
    "query, 1000 hits": 200,
}
CONTEXT = "https://w3id.org/handover/context.jsonld"
LINK = f'<{CONTEXT}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
HITS_IN_PROGRESS = 20
NOTIFICATIONS = 2000
"""So many that p99 is the time of the twentieth slowest."""


class Broker:
    """Our broker as a process, or (with a port) one that somebody else has started."""

    def __init__(self, data_dir: Path, settings: dict[str, str], port: int | None = None) -> None:
        self.is_ours = port is None
        self.port: int = port or free_ports(1)[0]
        self.data_dir = data_dir
        self.settings = settings
        self.process: subprocess.Popen[bytes] | None = None

    async def start(self) -> float:
        """Start and return the seconds until the first answer."""
        environment = {
            **os.environ,
            "HANDOVER_BROKER_PORT": str(self.port),
            "HANDOVER_DATA_DIR": str(self.data_dir),
            "HANDOVER_LOG_LEVEL": "warning",
            **self.settings,
        }
        started_s = time.perf_counter()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "handover_broker"], env=environment, stdin=subprocess.DEVNULL
        )
        while True:
            try:
                line = await Line.open(self.port)
                await line.exchange(request("GET", "/ngsi-ld/v1/types"))
            except OSError:
                if self.process.poll() is not None:
                    raise SystemExit("the broker did not start") from None
                await asyncio.sleep(0.002)
            else:
                line.close()
                return time.perf_counter() - started_s

    def memory_mb(self) -> float:
        """Return the resident memory in MB."""
        assert self.process is not None
        return float(psutil.Process(self.process.pid).memory_info().rss) / 1e6

    def stop(self) -> None:
        """End."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(timeout=20)


class Line:
    """One connection: a request is sent, its answer awaited."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    @classmethod
    async def open(cls, port: int) -> "Line":
        """Connect."""
        return cls(*await asyncio.open_connection("127.0.0.1", port, limit=1 << 24))

    async def exchange(self, sent: bytes) -> bytes:
        """Return the body of the answer; raise if the broker refuses."""
        self._writer.write(sent)
        head = await self._reader.readuntil(b"\r\n\r\n")
        length = head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0]
        body = await self._reader.readexactly(int(length)) if length else b""
        if not head.startswith(b"HTTP/1.1 2"):
            raise SystemExit(f"refused: {head.decode()} {body.decode()} to {sent[:300]!r}")
        return body

    def close(self) -> None:
        """Hang up."""
        self._writer.close()


def request(method: str, path: str, body: bytes = b"") -> bytes:
    """Return an HTTP request."""
    lines = [f"{method} {path} HTTP/1.1", "Host: 127.0.0.1", f"Link: {LINK}"]
    if body:
        lines += ["Content-Type: application/json", f"Content-Length: {len(body)}"]
    return ("\r\n".join(lines) + "\r\n\r\n").encode() + body


def task(number: int, status: str = "pending", kind: str = "Task") -> dict[str, Any]:
    """Return a Task of about 400 bytes."""
    return {
        "id": f"urn:ngsi-ld:{kind}:demo:{number}",
        "type": kind,
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
        "status": {"type": "Property", "value": status, "observedAt": "2026-01-01T12:00:00.000Z"},
        "workParameters": {
            "type": "Property",
            "value": {
                "description": "Confirm that the part lies free",
                "commandId": 3,
                "gesture": "Thumbs up",
            },
        },
    }


class Lane(asyncio.Protocol):
    """A connection over which requests go one after the other, with as little work of our own as can be."""

    def __init__(self, requests: Iterator[bytes], times_ms: list[float]) -> None:
        self._requests = requests
        self._times_ms = times_ms
        self.done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._buffer = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def ask(self) -> None:
        """Send the next request, or end."""
        sent = next(self._requests, None)
        if sent is None:
            self._transport.close()
            self.done.set_result(None)
        else:
            self._sent_s = time.perf_counter()
            self._transport.write(sent)

    def data_received(self, data: bytes) -> None:
        """Note the time of a whole answer; raise if the broker refuses."""
        self._buffer = self._buffer + data if self._buffer else data
        end = self._buffer.find(b"\r\n\r\n")
        if end < 0:
            return
        head = self._buffer[:end].lower()
        length = head.partition(b"content-length: ")[2].partition(b"\r\n")[0]
        if len(self._buffer) < end + 4 + int(length or 0):
            return
        self._times_ms.append((time.perf_counter() - self._sent_s) * 1e3)
        if not head.startswith(b"http/1.1 2"):
            self.done.set_exception(SystemExit(f"refused: {self._buffer.decode()}"))
            return
        self._buffer = b""
        self.ask()

    def connection_lost(self, error: Exception | None) -> None:
        """Say so if it was in the middle."""
        if not self.done.done():
            self.done.set_exception(error or ConnectionError("the broker hung up"))


async def load(port: int, requests: Iterable[bytes]) -> tuple[float, list[float]]:
    """Send `requests` over all connections; return how many a second were answered, and the times in ms."""
    waiting = iter(list(requests))  # made beforehand, so that making them is not measured
    times_ms: list[float] = []
    loop = asyncio.get_running_loop()
    lanes = [
        (await loop.create_connection(lambda: Lane(waiting, times_ms), "127.0.0.1", port))[1]
        for _ in range(CONNECTIONS)
    ]
    started_s = time.perf_counter()
    for lane in lanes:
        lane.ask()
    await asyncio.gather(*(lane.done for lane in lanes))
    return len(times_ms) / (time.perf_counter() - started_s), times_ms


def report(name: str, rounds: Sequence[tuple[float, list[float]]]) -> None:
    """Print a row."""
    rate = statistics.median(rate for rate, _ in rounds)
    times = sorted(itertools.chain.from_iterable(times for _, times in rounds))
    least = MIN_PER_S.get(name)
    against = "" if least is None else f"  minimum {least}: {rate / least:.2f} times"
    print(
        f"{name:28} {rate:9.0f}/s   p50 {quantile(times, 0.5):6.2f} ms   "
        f"p99 {quantile(times, 0.99):6.2f} ms{against}"
    )


def quantile(ordered: Sequence[float], share: float) -> float:
    """Return the value below which `share` of the ordered values lie."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


class Subscriber(asyncio.Protocol):
    """A subscriber on a bare socket: notes when each notification came, answers at once."""

    received_at: asyncio.Queue[float]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._buffer = b""

    def data_received(self, data: bytes) -> None:
        """Answer every whole notification."""
        self._buffer += data
        while True:
            head, blank, rest = self._buffer.partition(b"\r\n\r\n")
            if not blank:
                return
            length = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
            if len(rest) < length:
                return
            self._buffer = rest[length:]
            self.received_at.put_nowait(time.perf_counter())
            self._transport.write(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n")


async def notifications(broker: Broker, subscriptions: int, count: int) -> list[float]:
    """Return the times from PATCH to notification in ms, of `count` in sequence; one subscription matches."""
    kind = f"Notified{subscriptions}"
    Subscriber.received_at = asyncio.Queue()
    server = await asyncio.get_running_loop().create_server(Subscriber, "127.0.0.1", 0)
    url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/notify"
    line = await Line.open(broker.port)
    for number in range(subscriptions):
        body = {
            "id": f"urn:ngsi-ld:Subscription:demo:{kind}-{number}",
            "type": "Subscription",
            "entities": [{"type": kind, "id": f"urn:ngsi-ld:{kind}:demo:{number}"}],
            "watchedAttributes": ["status"],
            "notification": {"endpoint": {"uri": url, "accept": "application/json"}},
        }
        await line.exchange(request("POST", "/ngsi-ld/v1/subscriptions", orjson.dumps(body)))
    await line.exchange(request("POST", "/ngsi-ld/v1/entities", orjson.dumps(task(0, kind=kind))))
    await Subscriber.received_at.get()
    times_ms = []
    for patch in itertools.islice(patches(kind, itertools.repeat(0)), count):
        started_s = time.perf_counter()
        await line.exchange(patch)
        times_ms.append((await Subscriber.received_at.get() - started_s) * 1e3)
    line.close()
    server.close()
    return sorted(times_ms)


def patches(kind: str, numbers: Iterable[int]) -> Iterator[bytes]:
    """Yield patches of the status of Tasks."""
    for number in numbers:
        status = task(number)["status"]
        path = f"/ngsi-ld/v1/entities/urn:ngsi-ld:{kind}:demo:{number}/attrs"
        yield request("PATCH", path, orjson.dumps({"status": status}))


def queries(status: str, limit: int, count: int) -> list[bytes]:
    """Return queries for Tasks by status."""
    q = quote(f'status=="{status}"')
    path = f"/ngsi-ld/v1/entities?type=Task&q={q}&limit={limit}"
    return [request("GET", path)] * count


async def fill(broker: Broker, first: int, stored: int) -> None:
    """Store Tasks up to `stored`: 20 in progress, 1000 paused, the rest pending."""
    line = await Line.open(broker.port)
    for start in range(first, stored, 500):
        statuses = (
            "inProgress" if n < HITS_IN_PROGRESS else "paused" if n < 1020 else "pending"
            for n in itertools.count(start)
        )
        batch = [
            task(n, status)
            for n, status in zip(range(start, min(start + 500, stored)), statuses, strict=False)
        ]
        await line.exchange(request("POST", "/ngsi-ld/v1/entityOperations/create", orjson.dumps(batch)))
    line.close()


async def measure(broker: Broker, requests: int, rounds: int, stored: int, for_memory: int) -> None:
    """Print every row."""
    if broker.is_ours:
        starts_s = [await broker.start()]
        for _ in range(rounds - 1):
            broker.stop()
            starts_s.append(await broker.start())
        print(f"{'cold start':28} {statistics.median(starts_s) * 1e3:9.0f} ms  limit 800 ms")
        print(f"{'memory, empty':28} {broker.memory_mb():9.0f} MB  limit 90 MB")
    path = "/ngsi-ld/v1/entities"
    fresh = itertools.count(10_000_000)

    async def creations() -> tuple[float, list[float]]:
        bodies = (orjson.dumps(task(next(fresh), kind="New")) for _ in range(requests))
        return await load(broker.port, (request("POST", path, body) for body in bodies))

    report("create", [await creations() for _ in range(rounds)])
    await fill(broker, 0, 1000)
    report(
        "query, 20 hits (of 1000)",
        [await load(broker.port, queries("inProgress", 100, requests)) for _ in range(rounds)],
    )
    await fill(broker, 1000, stored)
    dice = random.Random(4)
    numbers = [dice.randrange(1020, stored) for _ in range(requests)]
    report("patch", [await load(broker.port, patches("Task", numbers)) for _ in range(rounds)])
    retrievals = [request("GET", f"{path}/urn:ngsi-ld:Task:demo:{number}") for number in numbers]
    report("retrieve", [await load(broker.port, retrievals) for _ in range(rounds)])
    report(
        "query, 20 hits",
        [await load(broker.port, queries("inProgress", 100, requests)) for _ in range(rounds)],
    )
    report(
        "query, 1000 hits",
        [await load(broker.port, queries("paused", 1000, requests // 10)) for _ in range(rounds)],
    )
    for subscriptions in (1, 100):
        times = await notifications(broker, subscriptions, NOTIFICATIONS)
        name = f"PATCH to notification, {subscriptions}"
        median_ms, p99_ms = quantile(times, 0.5), quantile(times, 0.99)
        print(
            f"{name:28} p50 {median_ms:.2f} ms, p99 {p99_ms:.2f} ms, {p99_ms - median_ms:.2f} ms above  "
            "limit 1 ms, 5 ms and 1 ms"
        )
    await fill(broker, stored, for_memory)
    if broker.is_ours:
        print(f"{f'memory, {for_memory + requests * rounds} entities':28} {broker.memory_mb():9.0f} MB")
    report(f"create, {for_memory} stored", [await creations() for _ in range(rounds)])


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--requests", type=int, default=4000, help="requests in a round")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the median counts")
    parser.add_argument("--stored", type=int, default=10_000, help="Tasks stored (more than 1100)")
    parser.add_argument(
        "--memory",
        type=int,
        default=100_000,
        help="Tasks stored at the end",
    )
    parser.add_argument("--url", help="measure this broker on loopback instead of starting ours")
    parser.add_argument("--database-url", help="where ours keeps its journal; a file of its own by default")
    options = parser.parse_args()
    settings = {"HANDOVER_BROKER_DATABASE_URL": options.database_url} if options.database_url else {}
    port = urlsplit(options.url).port if options.url else None
    with tempfile.TemporaryDirectory() as folder:
        broker = Broker(Path(folder), settings, port)
        try:
            with report_steal_time():
                asyncio.run(measure(broker, options.requests, options.rounds, options.stored, options.memory))
        finally:
            broker.stop()


if __name__ == "__main__":
    main()
