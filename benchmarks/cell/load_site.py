"""The installation of `benchmarks.cell.load`: services, page servers behind HAProxy, devices and sessions."""

import asyncio
import contextlib
import os
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import orjson
import psutil

from benchmarks.free_ports import free_ports
from handover.network.tls_trust import client_context
from handover.security.permissions import Grant, Role
from handover.security.secret_tokens import is_secret_token
from handover.transport_security.local_authority import LocalAuthority, ServerFiles
from handover_accounts.passwords import PasswordHashes
from handover_accounts.set_up import opened_store, set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage import sessions, users
from handover_accounts.storage.grants import add_grant

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
REPORT_EVERY_S = 10.0
SERVICES = {
    "context_broker": "handover_broker",
    "accounts": "handover_accounts",
    "device_gateway": "handover_devices",
}
PORTS = ("BROKER", "ACCOUNTS", "GATEWAY", "DEVICE", "WEBUI", "PROXY")


class LoadDevice(asyncio.Protocol):
    """A device that answers each command at once, and notes when it came."""

    def __init__(self, name: str, token: str, received: dict[str, float]) -> None:
        self._hello = {"type": "hello", "version": 1, "device": name, "token": token, "takes": [COMMAND]}
        self._received = received
        self._rest = b""
        self._seq = 0
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the hello."""
        self._transport = transport
        self._write(self._hello)
        self._report()

    def _report(self) -> None:
        """Send telemetry, also while no command comes: the gateway ends silent connections."""
        if self._transport.is_closing():
            return
        self._seq += 1
        self._write(
            {"type": "telemetry", "seq": self._seq, "t": time.time(), "values": {"temperature": 21.5}}
        )
        asyncio.get_running_loop().call_later(REPORT_EVERY_S, self._report)

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
        self.shared: dict[str, psutil.Process] = {}
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
        for service, module in SERVICES.items():
            self.shared[service] = self.start(module)
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
                    partial(LoadDevice, name, secret, self.received),
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
                "handover_web",
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
