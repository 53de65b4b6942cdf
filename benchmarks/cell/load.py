"""Many clients at once: new TLS connections, page, sensors and one command each, on one or more replicas.

    python -m benchmarks.cell.load [--clients 10000] [--per-minute 10000] [--replicas 1 2 4] [--delay-ms 30]

The load is open: a client starts when it is due, whether others have been answered or not, and its first
request counts from that time on, so a server that stalls is not spared (coordinated omission). Each client
has a session that was made beforehand, and an address of its own (`X-Forwarded-For`, the bench is a trusted
proxy). All processes share the cores of this machine, the bench too.

- `replicas`: page servers behind HAProxy (Debian: apt-get install haproxy), which passes on TLS connections;
  one of several is killed in the middle. Errors may be at most the clients that were open then, or began
  before the process had ended: until then its socket accepts connections.
- sign-ins: more than the hash workers can check, beside clients; the excess gets 429 with Retry-After.
- latency: 100 commands until the device has received them and until they are answered, without and with a
  relay that delays both directions.

Accounts, device gateway and broker run once, with their databases (SQLite).
"""

import argparse
import asyncio
import contextlib
import os
import shutil
import signal
import ssl
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import orjson
import psutil

from benchmarks.cell.load_site import COMMAND, DEVICES, PASSWORD, USERS, Site
from handover_accounts.storage import sessions

PAPER_MS = {"one server": 69.0, "balanced": 7.0}
"""IoHRT, stress test: mean response time of 10,000 clients a minute."""
REQUEST_TIMEOUT_S = 30.0


@dataclass
class Results:
    """Times in seconds, and faults by their text."""

    first_s: list[float] = field(default_factory=list)
    later_s: list[float] = field(default_factory=list)
    client_s: list[float] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    begun: int = 0
    open: int = 0
    most_open: tuple[int, float] = (0, 0.0)
    """How many clients were open at most, and when."""

    def line(self) -> str:
        """Return the times as text."""
        requests = [*self.first_s, *self.later_s]
        if not requests:
            return "no request was answered"
        return (
            f"mean {_ms(statistics.fmean(requests))} (p50 {_ms(_percentile(requests, 50))}, "
            f"p99 {_ms(_percentile(requests, 99))}, max {_ms(max(requests))}); "
            f"with the TLS connection {_ms(statistics.fmean(self.first_s))}, "
            f"on it {_ms(statistics.fmean(self.later_s or [0.0]))}; "
            f"whole client {_ms(statistics.fmean(self.client_s or [0.0]))}"
        )


class Client:
    """One client: a TLS connection of its own, and requests one after the other."""

    def __init__(self, site: Site, port: int, number: int) -> None:
        self._site = site
        self._port = port
        self.number = number
        token = site.tokens[number % len(site.tokens)]
        address = f"10.{number >> 16 & 255}.{number >> 8 & 255}.{number & 255}"
        self._head = (
            f"Host: localhost:{port}\r\nX-Forwarded-For: {address}\r\n"
            f"Cookie: handover_{site.ports['WEBUI']}={token}\r\n"
            f"X-CSRF-Token: {sessions.csrf_token(token)}\r\n"
        )
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def request(self, method: str, path: str, body: bytes = b"") -> tuple[int, bytes, bytes]:
        """Return status, head and body of the response."""
        if self._streams is None:
            self._streams = await asyncio.open_connection(
                "127.0.0.1", self._port, ssl=self._site.trust, server_hostname="localhost"
            )
        reader, writer = self._streams
        content = f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n" if body else ""
        writer.write(f"{method} {path} HTTP/1.1\r\n{self._head}{content}\r\n".encode() + body)
        head = await reader.readuntil(b"\r\n\r\n")
        lower = head.lower()
        if b"transfer-encoding: chunked" in lower:
            received = b""
            while size := int(await reader.readline(), 16):
                received += (await reader.readexactly(size + 2))[:-2]
            await reader.readline()
        else:
            received = await reader.readexactly(int(lower.partition(b"content-length:")[2].split()[0]))
        return int(head[9:12]), head, received

    def close(self) -> None:
        """Close the connection without waiting for the other side."""
        if self._streams is not None:
            self._streams[1].transport.abort()

    async def visit(self, due_s: float, results: Results) -> None:
        """Open the page, read the sensors, send one command; `due_s` is when the client wanted to start."""
        began_s = due_s
        command = orjson.dumps({"name": COMMAND, "parameters": {}})
        requests = (
            ("GET", "/", b""),
            ("GET", "/api/device-gateway/devices", b""),
            ("POST", f"/api/device-gateway/devices/d-{self.number % DEVICES}/commands", command),
        )
        results.begun += 1
        results.open += 1
        if results.open > results.most_open[0]:
            results.most_open = results.open, due_s
        try:
            async with asyncio.timeout(REQUEST_TIMEOUT_S):
                for place, (method, path, body) in enumerate(requests):
                    status, _, received = await self.request(method, path, body)
                    now_s = time.perf_counter()
                    if status >= 300:
                        results.faults[f"{method} {path.split('/d-')[0]}: {status} {received[:120]!r}"] += 1
                        return
                    (results.later_s if place else results.first_s).append(now_s - began_s)
                    began_s = now_s
            results.client_s.append(began_s - due_s)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, ssl.SSLError) as error:
            results.faults[type(error).__name__] += 1
        finally:
            results.open -= 1
            self.close()


async def open_loop(count: int, per_s: float, start: Callable[[int, float], Any]) -> None:
    """Start `count` coroutines at their times, whether the others have ended or not; wait for all."""
    began_s = time.perf_counter()
    async with asyncio.TaskGroup() as group:
        for number in range(count):
            due_s = began_s + number / per_s
            if (wait_s := due_s - time.perf_counter()) > 0:
                await asyncio.sleep(wait_s)
            group.create_task(start(number, due_s))


async def stress(site: Site, replicas: int, clients: int, per_s: float) -> int:
    """Run the stress test on `replicas`, of which one is killed if there are several; return the errors."""
    async with site.page(replicas) as port:
        warm = Results()
        await open_loop(
            min(50, clients), per_s, lambda number, due_s: Client(site, port, number).visit(due_s, warm)
        )
        results, allowed, survivors = Results(), 0, list(site.replicas)
        cpu_s = {replica.pid: cpu_time_s(replica) for replica in site.replicas}
        shared_s = {name: cpu_time_s(process) for name, process in site.shared.items()}
        own_s, began_s, machine_s = time.process_time(), time.perf_counter(), busy_s()

        async def visit(number: int, due_s: float) -> None:
            nonlocal allowed
            if replicas > 1 and number == clients // 2:
                victim = survivors.pop()
                cpu_s[victim.pid] = cpu_time_s(victim) - cpu_s[victim.pid]
                allowed, begun = results.open, results.begun
                victim.send_signal(signal.SIGKILL)
                await asyncio.to_thread(os.waitid, os.P_PID, victim.pid, os.WEXITED | os.WNOWAIT)
                allowed += results.begun - begun
            await Client(site, port, number).visit(due_s, results)

        await open_loop(clients, per_s, visit)
        took_s = time.perf_counter() - began_s
        own_s, machine_s = time.process_time() - own_s, busy_s() - machine_s
        for replica in survivors:
            cpu_s[replica.pid] = cpu_time_s(replica) - cpu_s[replica.pid]
        used_s = {"page servers": sum(cpu_s.values())} | {
            name: cpu_time_s(process) - shared_s[name] for name, process in site.shared.items()
        }
        used_s |= {"all": sum(used_s.values()), "the clients of this bench": own_s}
        errors = sum(results.faults.values())
        print(
            f"{replicas} replica(s), {clients} clients in {took_s:.1f} s "
            f"({60 * clients / took_s:,.0f} a minute)"
        )
        print(f"  response: {results.line()}")
        spread = ", ".join(f"{100 * used / took_s:.0f} %" for used in cpu_s.values())
        print(f"  CPU of a core for each replica{' (the last was killed)' if replicas > 1 else ''}: {spread}")
        print(
            f"  CPU time of a client: {', '.join(f'{name} {_ms(s / clients)}' for name, s in used_s.items())}"
        )
        others = max(machine_s - sum(used_s.values()) + used_s["all"], 0.0) / took_s
        most, when_s = results.most_open
        print(
            f"  other work on this machine, with HAProxy: {others:.1f} of {psutil.cpu_count()} cores; "
            f"most clients open at once: {most}, after {when_s - began_s:.1f} s"
        )
        print(
            f"  errors: {errors}; clients that were open when a replica was killed: {allowed}; "
            f"{dict(results.faults) or ''}"
        )
        return max(0, errors - allowed)


def busy_s() -> float:
    """Return the CPU time that all processes of this machine have used."""
    times = psutil.cpu_times()
    return float(times.user + times.nice + times.system + times.irq + times.softirq)


def cpu_time_s(process: psutil.Process) -> float:
    """Return the CPU time that a process has used, which other processes do not change much."""
    return float(sum(process.cpu_times()[:2]))


async def sign_ins(site: Site, per_s: float, seconds: float) -> int:
    """Sign in more often than the hash workers can check, beside clients; return the wrong answers."""
    async with site.page(1) as port:
        alone, beside = Results(), Results()
        count = int(20 * seconds)
        await open_loop(count, 20, lambda number, due_s: Client(site, port, number).visit(due_s, alone))
        statuses: Counter[int] = Counter()
        without_retry = 0

        async def sign_in(number: int, _: float) -> None:
            nonlocal without_retry
            client = Client(site, port, 100_000 + number)
            body = orjson.dumps({"name": f"user {number % USERS}", "password": PASSWORD})
            try:
                status, head, _body = await client.request("POST", "/api/session", body)
            finally:
                client.close()
            statuses[status] += 1
            without_retry += status == 429 and b"retry-after:" not in head.lower()

        async with asyncio.TaskGroup() as group:
            group.create_task(open_loop(int(per_s * seconds), per_s, sign_in))
            group.create_task(
                open_loop(count, 20, lambda number, due_s: Client(site, port, number).visit(due_s, beside))
            )
        print(f"sign-ins, {per_s:.0f} a second for {seconds:.0f} s: {dict(sorted(statuses.items()))}")
        print(f"  429 without Retry-After: {without_retry}")
        print(f"  clients alone:  {alone.line()}")
        print(f"  clients beside: {beside.line()}")
        wrong = sum(number for status, number in statuses.items() if status not in {200, 429})
        return wrong + without_retry + sum(beside.faults.values())


@contextlib.asynccontextmanager
async def delayed(port: int, delay_s: float) -> AsyncIterator[int]:
    """Relay connections to `port`, with `delay_s` in each direction; yield the port of the relay."""

    async def pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        while data := await reader.read(65536):
            loop.call_later(delay_s, writer.write, data)
        loop.call_later(delay_s, writer.close)

    async def relay(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.CancelledError):  # cancelled at the end of the loop
            there_reader, there_writer = await asyncio.open_connection("127.0.0.1", port)
            await asyncio.gather(pump(reader, there_writer), pump(there_reader, writer))

    server = await asyncio.start_server(relay, "127.0.0.1", 0)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        server.close()


async def latency(site: Site, delay_ms: float, rounds: int = 100) -> int:
    """Send commands one after the other; print when the device had them and when they were answered."""
    async with site.page(1) as page:
        for added_ms in (0.0, delay_ms):
            async with delayed(page, added_ms / 2000) as port:
                client = Client(site, port, 1)
                body = orjson.dumps({"name": COMMAND, "parameters": {}})
                path = "/api/device-gateway/devices/d-1/commands"
                await client.request("POST", path, body)  # connects
                received, answered = [], []
                for _ in range(rounds):
                    sent_s = time.perf_counter()
                    status, _, answer = await client.request("POST", path, body)
                    answered.append(time.perf_counter() - sent_s)
                    assert status == 202, answer
                    identifier = orjson.loads(answer)["id"]
                    async with asyncio.timeout(REQUEST_TIMEOUT_S):
                        while identifier not in site.received:
                            await asyncio.sleep(0.0005)
                    received.append(site.received[identifier] - sent_s)
                client.close()
            for name, times in (("to the device", received), ("answered", answered)):
                mean, most = _ms(statistics.fmean(times)), _ms(max(times))
                print(f"{rounds} round trips with {added_ms:g} ms added, {name}: mean {mean}, max {most}")
    print("  IoHRT, over the Atlantic: mean 33.7 ms, max 72 ms")
    return 0


def _percentile(values: Sequence[float], percent: int) -> float:
    return sorted(values)[min(len(values) - 1, len(values) * percent // 100)]


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms"


@contextlib.contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


async def run(asked: argparse.Namespace) -> int:
    """Run what was asked for; return the number of errors beyond those that are allowed."""
    per_s = asked.per_minute / 60
    with _folder() as folder:
        site = Site(folder)
        try:
            await site.begin()
            await site.make_sessions(asked.clients)
            errors = 0
            for replicas in asked.replicas:
                if replicas > 1 and shutil.which("haproxy") is None:
                    print(
                        f"{replicas} replicas: there is no haproxy; install it with: apt-get install haproxy"
                    )
                    continue
                errors += await stress(site, replicas, asked.clients, per_s)
            errors += await sign_ins(site, asked.sign_ins_per_s, asked.sign_in_s)
            errors += await latency(site, asked.delay_ms)
        finally:
            site.stop()
    paper = ", ".join(f"{name} {value:g} ms" for name, value in PAPER_MS.items())
    print(f"IoHRT, mean of 10,000 clients a minute: {paper}")
    return errors


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clients", type=int, default=10_000, help="clients of each stress test")
    parser.add_argument("--per-minute", type=float, default=10_000, help="clients that start in a minute")
    parser.add_argument("--replicas", type=int, nargs="*", default=[1, 2, 4], help="numbers of page servers")
    parser.add_argument("--sign-ins-per-s", type=float, default=50.0)
    parser.add_argument("--sign-in-s", type=float, default=10.0)
    parser.add_argument("--delay-ms", type=float, default=30.0, help="delay of a round trip")
    errors = asyncio.run(run(parser.parse_args()))
    if errors:
        raise SystemExit(f"{errors} errors more than the clients that were open when a replica was killed")


if __name__ == "__main__":
    main()
