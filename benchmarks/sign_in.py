"""An attack on the sign-in: wrong passwords at a fixed rate, while a person signs in from another address.

    python -m benchmarks.sign_in                  # 1,000 attempts a second for a minute
    python -m benchmarks.sign_in --addresses 500  # from many addresses

Attempts are sent when they are due, whether or not the ones before are answered (open loop). The person signs
in every two seconds with the right password, from an address of their own. Printed are the rate that was
reached, the answers, and how long the person waited, as ratio to the sign-in without an attack.
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
from pathlib import Path

import orjson

from benchmarks.handover import free_ports
from handover.http_client import BodyReadingHttpClient, SendError
from services.accounts.set_up import service_token_file, set_up
from services.accounts.settings import AccountsSettings

PASSWORD = "correct horse battery"
NAME = "Anna"
HOME = "192.0.2.7"
EVERY_S = 2.0
MAX_WAIT_S = 90.0


class Accounts:
    """The service in a process of its own, asked as the page server asks it."""

    def __init__(self, folder: Path) -> None:
        (port,) = free_ports(1)
        self.settings = AccountsSettings(data_dir=folder, accounts_port=port, _env_file=None)
        self.link = set_up(self.settings, ["webui", "accounts"]).owner_link
        environment = {**os.environ, "HANDOVER_DATA_DIR": str(folder), "HANDOVER_ACCOUNTS_PORT": str(port)}
        secret = service_token_file(self.settings, "webui").read_text().strip()
        self._headers = [("Authorization", f"Bearer {secret}"), ("Content-Type", "application/json")]
        self.http = BodyReadingHttpClient()
        command = [sys.executable, "-m", "services.accounts"]
        self.process = subprocess.Popen(command, env=environment, cwd=folder)

    async def post(self, path: str, body: dict[str, str]) -> int:
        """Return the status of the answer; 0 for none."""
        url = f"http://127.0.0.1:{self.settings.accounts_port}{path}"
        try:
            answer = await self.http.request("POST", url, self._headers, orjson.dumps(body), MAX_WAIT_S)
        except (SendError, OSError):
            return 0
        return answer.status

    async def sign_in(self, password: str, address: str) -> int:
        """Sign in from an address, as the page server reports it."""
        body = {"name": NAME, "password": password, "address": address, "device": "bench"}
        return await self.post("/sessions", body)

    async def prepare(self) -> None:
        """Wait until the service answers, and make the account."""
        body = {"link": self.link or "", "name": NAME, "password": PASSWORD, "address": "198.51.100.1"}
        deadline_s = time.monotonic() + MAX_WAIT_S
        while await self.post("/links/use", body) != 201:
            if time.monotonic() > deadline_s:
                raise SystemExit("accounts does not answer")
            await asyncio.sleep(0.2)


async def waits_of(accounts: Accounts, seconds: float) -> tuple[list[float], list[int]]:
    """Sign in every `EVERY_S`, and return how long each took, and the answers."""
    waits, answers = [], []
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        began_s = time.monotonic()
        answers.append(await accounts.sign_in(PASSWORD, HOME))
        waits.append(time.monotonic() - began_s)
        await asyncio.sleep(max(EVERY_S - waits[-1], 0.0))
    return waits, answers


async def attack(accounts: Accounts, rate: float, seconds: float, addresses: int) -> Counter[int]:
    """Send wrong passwords at `rate`; return the answers by status, 0 for none."""
    answers: Counter[int] = Counter()
    pending: set[asyncio.Task[None]] = set()

    async def attempt(number: int) -> None:
        address = f"203.0.{number % addresses // 250}.{number % addresses % 250 + 1}"
        answers[await accounts.sign_in("wrong password", address)] += 1

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


async def measure(accounts: Accounts, rate: float, seconds: float, addresses: int) -> None:
    """Measure without and with the attack, and print both."""
    await accounts.prepare()
    quiet, _ = await waits_of(accounts, 4 * EVERY_S)
    began_s = time.monotonic()
    attacking = asyncio.create_task(attack(accounts, rate, seconds, addresses))
    waits, answers = await waits_of(accounts, seconds)
    by_status = await attacking
    took_s = time.monotonic() - began_s
    total = by_status.total()
    print(f"attack: {total} attempts from {addresses} addresses, {total / took_s:.0f} a second answered")
    print(f"answers: {dict(by_status)} (401 hashed, 429 limited before hashing, 0 connection refused)")
    print(f"the person: {Counter(answers)[201]} of {len(answers)} sign-ins accepted")
    median = statistics.median(waits)
    print(f"wait: median {median:.2f} s, longest {max(waits):.2f} s (aim: 3 s)")
    before = statistics.median(quiet)
    print(f"without the attack: median {before:.2f} s; ratio {median / before:.1f}")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="attempts a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--addresses", type=int, default=1, help="of the attacker")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        accounts = Accounts(Path(folder))
        try:
            asyncio.run(measure(accounts, given.rate, given.seconds, given.addresses))
        finally:
            accounts.process.terminate()
            accounts.process.wait(30)


if __name__ == "__main__":
    main()
