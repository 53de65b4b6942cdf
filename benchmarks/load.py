"""Many clients at once: new TLS connections, page, sensors and one command each, on one or more replicas.

    python -m benchmarks.load [--clients 10000] [--per-minute 10000] [--replicas 1 2 4] [--delay-ms 30]

The load is open: a client starts when it is due, whether others have been answered or not, and its first
request counts from that time on, so a server that stalls is not spared (coordinated omission). Each client
has a session that was made beforehand, and an address of its own (`X-Forwarded-For`, the bench is a trusted
proxy). All processes share the cores of this machine, the bench too.

- `replicas`: page servers behind HAProxy (Debian: apt-get install haproxy), which passes on TLS connections;
  one of several is killed in the middle. Errors may be at most the clients that were open then.
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
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import orjson
import psutil

from benchmarks.handover import free_ports
from handover.security.permissions import Grant, Role
from handover.security.secret_tokens import is_secret_token
from handover.tls_trust import client_context
from handover.transport_security.local_authority import LocalAuthority, ServerFiles
from services.accounts import sessions, users
from services.accounts.grants import add_grant
from services.accounts.passwords import PasswordHashes
from services.accounts.set_up import opened_store, set_up
from services.accounts.settings import AccountsSettings

PAPER_MS = {"one server": 69.0, "balanced": 7.0}
"""IoHRT, stress test: mean response time of 10,000 clients a minute."""
PASSWORD = "correct horse battery"
USERS = 200
DEVICES = 20
COMMAND = "setInterval"
DESCRIPTION = {
    "kind": "sensor",
    "sensors": [{"name": "temperature"}],
    "commands": [{"name": COMMAND, "kind": "setting"}],
}
READY_TIMEOUT_S = 120.0
REQUEST_TIMEOUT_S = 30.0
SERVICES = ("context_broker", "accounts", "device_gateway")
PORTS = ("BROKER", "ACCOUNTS", "GATEWAY", "DEVICE", "WEBUI", "PROXY")


@dataclass
class Results:
    """Times in seconds, and faults by their text."""

    first_s: list[float] = field(default_factory=list)
    later_s: list[float] = field(default_factory=list)
    client_s: list[float] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    open: int = 0

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


class Device(asyncio.Protocol):
    """A device that answers each command at once, and notes when it came."""

    def __init__(self, name: str, token: str, received: dict[str, float]) -> None:
        self._hello = {"type": "hello", "version": 1, "device": name, "token": token, "takes": [COMMAND]}
        self._received = received
        self._rest = b""
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the hello."""
        self._transport = transport
        self._write(self._hello)
        self._write({"type": "telemetry", "seq": 1, "t": time.time(), "values": {"temperature": 21.5}})

    def data_received(self, data: bytes) -> None:
        """Answer commands."""
        now_s = time.perf_counter()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            message = orjson.loads(line)
            if message["type"] == "command":
                self._received[message["id"]] = now_s
                self._write({"type": "ack", "id": message["id"], "state": "done"})

    def _write(self, message: dict[str, Any]) -> None:
        self._transport.write(orjson.dumps(message) + b"\n")


class Site:
    """The services as processes in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ports = dict(zip(PORTS, free_ports(len(PORTS)), strict=True))
        self.files: ServerFiles = LocalAuthority(folder / "tls").secure(folder / "tls/server", ())
        self.trust = client_context(self.files.authority)
        self.received: dict[str, float] = {}
        self._processes: list[subprocess.Popen[bytes]] = []
        self.replicas: list[psutil.Process] = []
        self.tokens: list[str] = []

    @property
    def environment(self) -> dict[str, str]:
        """The environment of the services."""
        plain = {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}
        return {
            **plain,
            "HANDOVER_DATA_DIR": str(self.folder),
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{self.ports['BROKER']}",
            "HANDOVER_LOG_LEVEL": "warning",
            "HANDOVER_TRUSTED_PROXIES": "127.0.0.1",
            **{f"HANDOVER_{name}_PORT": str(port) for name, port in self.ports.items() if name != "PROXY"},
        }

    def start(self, module: str, **more: str) -> psutil.Process:
        """Start a process."""
        with (self.folder / "log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module], env=self.environment | more, stdout=log, stderr=log
            )
        self._processes.append(process)
        return psutil.Process(process.pid)

    def stop(self) -> None:
        """End all processes."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()

    def settings(self) -> AccountsSettings:
        """The settings of accounts."""
        return AccountsSettings.load(data_dir=self.folder, accounts_port=self.ports["ACCOUNTS"])

    async def begin(self) -> None:
        """Set up accounts, and start what the replicas share."""
        set_up(self.settings(), ["context-broker", "accounts", "device-gateway", "webui", "cli"])
        for service in SERVICES:
            self.start(f"services.{service}")
        for name in ("BROKER", "ACCOUNTS", "GATEWAY"):
            await self.ready(f"http://127.0.0.1:{self.ports[name]}/readyz")
        await self._connect_devices()

    async def ready(self, url: str) -> None:
        """Wait until a service is ready."""
        async with (
            asyncio.timeout(READY_TIMEOUT_S),
            httpx.AsyncClient(verify=self.trust, trust_env=False) as http,
        ):
            while True:
                with contextlib.suppress(httpx.TransportError):
                    if (await http.get(url, timeout=30)).is_success:
                        return
                await asyncio.sleep(0.1)

    async def _connect_devices(self) -> None:
        loop = asyncio.get_running_loop()
        token = (self.folder / "security/service-tokens/cli").read_text().strip()
        gateway = f"http://127.0.0.1:{self.ports['GATEWAY']}"
        async with httpx.AsyncClient(
            base_url=gateway, timeout=60, trust_env=False, headers={"Authorization": f"Bearer {token}"}
        ) as http:
            for number in range(DEVICES):
                name = f"d-{number}"
                body = {"name": name, "description": DESCRIPTION}
                async with asyncio.timeout(READY_TIMEOUT_S):  # until the gateway knows the revocations
                    while (made := await http.post("/devices", json=body)).status_code == 503:
                        await asyncio.sleep(0.2)
                secret = made.raise_for_status().json()["token"]
                await loop.create_connection(
                    lambda name=name, secret=secret: Device(name, secret, self.received),
                    "127.0.0.1",
                    self.ports["DEVICE"],
                )

    async def make_sessions(self, count: int) -> None:
        """Make sessions of users who may command devices, as signing in does, without hashing each time."""
        hashes = PasswordHashes(1)
        hashed = await hashes.hash(PASSWORD)
        hashes.close()

        def make() -> list[str]:
            made = []
            with opened_store(self.settings()) as store, store.change("bench") as change:
                names = [f"user {number}" for number in range(max(USERS, -(-count // sessions.MAX_SESSIONS)))]
                subjects = [users.add_user(change, name, hashed) for name in names]
                for subject in subjects:
                    add_grant(change, subject, Grant(Role.ENGINEER))
                for number in range(count):
                    subject = subjects[number % len(subjects)]
                    _, token = sessions.open_session(
                        change, subject, method="password", address="127.0.0.1", device="bench"
                    )
                    made.append(token)
            return made

        self.tokens = await asyncio.to_thread(make)
        assert is_secret_token(self.tokens[0])

    @contextlib.asynccontextmanager
    async def page(self, replicas: int) -> AsyncIterator[int]:
        """Run page servers, behind HAProxy if there are several; yield the port for clients."""
        certificate = {
            "HANDOVER_TLS_CERTIFICATE": str(self.files.certificate),
            "HANDOVER_TLS_KEY": str(self.files.key),
            "HANDOVER_TLS_AUTHORITY": str(self.files.authority),
        }
        hosts = [f"127.0.0.{2 + number}" if replicas > 1 else "127.0.0.1" for number in range(replicas)]
        before = len(self._processes)
        self.replicas = [
            self.start(
                "webui",
                HANDOVER_HOST=host,
                HANDOVER_INSTANCE=f"replica-{number}",
                HANDOVER_DATA_DIR=str(self.folder / f"webui-{number}"),
                HANDOVER_SECURITY_DIR=str(self.folder / "security"),
                HANDOVER_ACCOUNTS_URL=f"http://127.0.0.1:{self.ports['ACCOUNTS']}",
                HANDOVER_GATEWAY_URL=f"http://127.0.0.1:{self.ports['GATEWAY']}",
                HANDOVER_BROKER_URL=f"http://127.0.0.1:{self.ports['BROKER']}",
                **certificate,
            )
            for number, host in enumerate(hosts)
        ]
        try:
            for _ in hosts:
                await self.ready(
                    f"https://127.0.0.1:{self.ports['WEBUI']}/healthz"
                ) if replicas == 1 else None
            if replicas == 1:
                yield self.ports["WEBUI"]
                return
            await self._balance(hosts)
            yield self.ports["PROXY"]
        finally:
            for process in self._processes[before:]:
                process.terminate()
            for process in self._processes[before:]:
                process.wait()
            del self._processes[before:]

    async def _balance(self, hosts: Sequence[str]) -> None:
        port = self.ports["WEBUI"]
        for host in hosts:
            async with asyncio.timeout(READY_TIMEOUT_S):
                while True:
                    with contextlib.suppress(OSError):
                        _, writer = await asyncio.open_connection(host, port)
                        writer.close()
                        break
                    await asyncio.sleep(0.1)
        servers = "\n".join(f"    server {host} {host}:{port} check inter 500ms fall 1" for host in hosts)
        file = self.folder / "haproxy.cfg"
        file.write_text(f"""global
    maxconn 4000
defaults
    mode tcp
    timeout connect 2s
    timeout client 60s
    timeout server 60s
    retries 3
    option redispatch 1
listen page
    bind 127.0.0.1:{self.ports["PROXY"]}
    balance roundrobin
    option tcp-check
{servers}
""")
        with (self.folder / "haproxy.log").open("ab") as log:
            self._processes.append(
                subprocess.Popen(["haproxy", "-db", "-f", str(file)], stdout=log, stderr=log)
            )
        await self.ready(f"https://localhost:{self.ports['PROXY']}/healthz")


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
        results.open += 1
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
        cpu_s = {replica.pid: sum(replica.cpu_times()[:2]) for replica in site.replicas}
        began_s = time.perf_counter()

        async def visit(number: int, due_s: float) -> None:
            nonlocal allowed
            if replicas > 1 and number == clients // 2:
                victim = survivors.pop()
                cpu_s[victim.pid] = sum(victim.cpu_times()[:2]) - cpu_s[victim.pid]
                allowed = results.open
                victim.send_signal(signal.SIGKILL)
            await Client(site, port, number).visit(due_s, results)

        await open_loop(clients, per_s, visit)
        took_s = time.perf_counter() - began_s
        for replica in survivors:
            cpu_s[replica.pid] = sum(replica.cpu_times()[:2]) - cpu_s[replica.pid]
        errors = sum(results.faults.values())
        print(
            f"{replicas} replica(s), {clients} clients in {took_s:.1f} s "
            f"({60 * clients / took_s:,.0f} a minute)"
        )
        print(f"  response: {results.line()}")
        spread = ", ".join(f"{100 * used / took_s:.0f} %" for used in cpu_s.values())
        print(f"  CPU of a core for each replica{' (the last was killed)' if replicas > 1 else ''}: {spread}")
        print(
            f"  errors: {errors}; clients that were open when a replica was killed: {allowed}; "
            f"{dict(results.faults) or ''}"
        )
        return max(0, errors - allowed)


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
                status, head, _ = await client.request("POST", "/api/session", body)
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
