"""An attack on the sign-in: wrong passwords at a fixed rate, while a person signs in from another address.

    python -m benchmarks.cell.sign_in                  # 1,000 attempts a second for a minute
    python -m benchmarks.cell.sign_in --addresses 500  # from many addresses

Attempts are sent to the page server when they are due, whether or not the ones before are answered (open
loop). The person signs in every two seconds with the right password, from an address of their own, and
reads who is signed in. Addresses stand in `X-Forwarded-For`: the bench is a trusted proxy. Printed are the
rate that was reached, the answers, what each attempt cost the services, and how long the person waited.
"""

import argparse
import asyncio
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import orjson
import psutil

from benchmarks.free_ports import free_ports
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings

PASSWORD = "correct horse battery"
NAME = "Anna"
HOME = "192.0.2.7"
EVERY_S = 2.0
MAX_WAIT_S = 90.0


class Answer(NamedTuple):
    """The answer to a request."""

    status: int
    has_retry_after: bool


class SignInCell:
    """The page server and `accounts` in processes of their own."""

    def __init__(self, folder: Path) -> None:
        ports = dict(zip(("ACCOUNTS", "WEBUI", "BROKER"), free_ports(3), strict=True))
        self.settings = AccountsSettings(data_dir=folder, accounts_port=ports["ACCOUNTS"], _env_file=None)
        self.link = set_up(self.settings, ["webui", "accounts"]).owner_link
        plain = {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}
        environment = {
            **plain,
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_TRUSTED_PROXIES": "127.0.0.1",
            "HANDOVER_LOG_LEVEL": "error",
            **{f"HANDOVER_{name}_PORT": str(port) for name, port in ports.items()},
        }
        self.page = f"http://127.0.0.1:{ports['WEBUI']}"
        self.http = BodyReadingHttpClient()
        self._processes = {
            name: subprocess.Popen([sys.executable, "-m", module], env=environment, cwd=folder)
            for name, module in (("accounts", "handover_accounts"), ("page server", "handover_web"))
        }

    def cpu_s(self) -> dict[str, float]:
        """Return the CPU time that each service has used."""
        times = {name: psutil.Process(process.pid).cpu_times() for name, process in self._processes.items()}
        return {name: float(spent.user + spent.system) for name, spent in times.items()}

    def stop(self) -> None:
        """End the services."""
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            process.wait(30)

    async def ask(self, path: str, address: str, body: dict[str, str] | None = None) -> Answer:
        """Return the answer to a request from an address; the status is 0 for none."""
        headers = [("X-Forwarded-For", address), ("Content-Type", "application/json")]
        content = b"" if body is None else orjson.dumps(body)
        method = "GET" if body is None else "POST"
        try:
            answer = await self.http.request(method, self.page + path, headers, content, MAX_WAIT_S)
        except (SendError, OSError):
            return Answer(0, False)
        return Answer(answer.status, "retry-after" in answer.headers)

    async def sign_in(self, password: str, address: str) -> Answer:
        """Sign in from an address."""
        return await self.ask("/api/session", address, {"name": NAME, "password": password})

    async def prepare(self) -> None:
        """Wait until the services answer, and make the account."""
        body = {"link": self.link or "", "name": NAME, "password": PASSWORD}
        deadline_s = time.monotonic() + MAX_WAIT_S
        while (await self.ask("/api/session/link-use", "198.51.100.1", body)).status != 200:
            if time.monotonic() > deadline_s:
                raise SystemExit("the services do not answer")
            await asyncio.sleep(0.5)


@dataclass
class Person:
    """What a person saw: how long signing in and another request took, in seconds, and the answers."""

    sign_ins_s: list[float] = field(default_factory=list)
    reads_s: list[float] = field(default_factory=list)
    answers: Counter[int] = field(default_factory=Counter)


async def person(cell: SignInCell, seconds: float) -> Person:
    """Sign in and read something every `EVERY_S`."""
    seen = Person()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        began_s = time.monotonic()
        seen.answers[(await cell.sign_in(PASSWORD, HOME)).status] += 1
        signed_in_s = time.monotonic()
        await cell.ask("/api/session", HOME)
        seen.sign_ins_s.append(signed_in_s - began_s)
        seen.reads_s.append(time.monotonic() - signed_in_s)
        await asyncio.sleep(max(EVERY_S - (time.monotonic() - began_s), 0.0))
    return seen


async def attack(cell: SignInCell, rate: float, seconds: float, addresses: int) -> Counter[Answer]:
    """Send wrong passwords at `rate`; return the answers."""
    answers: Counter[Answer] = Counter()
    pending: set[asyncio.Task[None]] = set()

    async def attempt(number: int) -> None:
        address = f"203.0.{number % addresses // 250}.{number % addresses % 250 + 1}"
        answers[await cell.sign_in("wrong password", address)] += 1

    began_s = time.monotonic()
    for number in range(int(rate * seconds)):
        late_s = time.monotonic() - began_s - number / rate
        if late_s < 0:
            await asyncio.sleep(-late_s)
        task = asyncio.create_task(attempt(number))
        pending.add(task)
        task.add_done_callback(pending.discard)
    print(f"sent in {time.monotonic() - began_s:.1f} s")
    await asyncio.gather(*pending)
    return answers


async def measure(cell: SignInCell, rate: float, seconds: float, addresses: int) -> None:
    """Measure without and with the attack, and print both."""
    await cell.prepare()
    quiet = await person(cell, 4 * EVERY_S)
    began_s, cpu_s = time.monotonic(), cell.cpu_s()
    attacking = asyncio.create_task(attack(cell, rate, seconds, addresses))
    seen = await person(cell, seconds)
    answers = await attacking
    took_s, total = time.monotonic() - began_s, answers.total()
    by_status = Counter[int]()
    for answer, count in answers.items():
        by_status[answer.status] += count
    without = sum(
        count for outcome, count in answers.items() if outcome.status == 429 and not outcome.has_retry_after
    )
    print(f"attack: {total} attempts from {addresses} addresses, {total / took_s:.0f} a second answered")
    print(f"answers: {dict(by_status)} (401 hashed, 429 limited before hashing, 0 connection refused)")
    print(f"429 without Retry-After: {without}")
    for name, used_s in cell.cpu_s().items():
        each_us = 1e6 * (used_s - cpu_s[name]) / total
        print(f"CPU time of {name}: {used_s - cpu_s[name]:.1f} s, {each_us:.0f} us for each attempt")
    print(f"the person: {seen.answers[200]} of {seen.answers.total()} sign-ins accepted")
    for name, aim, before, now in (
        ("sign in", " (aim: 3 s)", quiet.sign_ins_s, seen.sign_ins_s),
        ("read", "", quiet.reads_s, seen.reads_s),
    ):
        median, most = statistics.median(now), max(now)
        was = statistics.median(before)
        print(f"{name}: median {median:.3f} s, longest {most:.2f} s{aim}; without the attack {was:.3f} s")
    print(f"load of the machine: {', '.join(f'{load:.1f}' for load in os.getloadavg())}")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="attempts a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--addresses", type=int, default=1, help="of the attacker")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        cell = SignInCell(Path(folder))
        try:
            asyncio.run(measure(cell, options.rate, options.seconds, options.addresses))
        finally:
            cell.stop()


if __name__ == "__main__":
    main()
