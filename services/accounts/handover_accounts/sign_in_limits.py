"""Limits of attempts to sign in, checked before a password is hashed.

Each attempt counts as failed until it has succeeded, so that attempts at the same time count too. There are
three counts:

- of an address for one account: after `FREE_ATTEMPTS`, the delay doubles with each failure up to
  `MAX_DELAY_S`. Once an account has had `ATTACKED_AFTER` failures from anywhere, an address has one free
  attempt for it;
- of an address for all accounts, with more free attempts and a shorter delay: many people may share it;
- of an account, which never delays by itself: somebody else's failures do not shut its user out.

No delay is for ever: counts are forgotten an hour after the last attempt. They are kept in memory, so a
restart forgets them too.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Final, TypeVar

from handover.network.client_networks import network_of

FREE_ATTEMPTS: Final = 5
ATTACKED_AFTER: Final = 20
MAX_DELAY_S: Final = 300.0
FREE_ATTEMPTS_OF_ADDRESS: Final = 20
MAX_DELAY_OF_ADDRESS_S: Final = 30.0
FORGOTTEN_AFTER_S: Final = 3600.0
MAX_COUNTS: Final = 100_000

Key = TypeVar("Key")


@dataclass(slots=True)
class _Count:
    failures: int = 0
    last_s: float = 0.0
    next_s: float = 0.0


class SignInLimits:
    """Counts attempts by address and account; times are arguments, in seconds."""

    def __init__(self) -> None:
        self._pairs: OrderedDict[tuple[str, str], _Count] = OrderedDict()
        self._addresses: OrderedDict[str, _Count] = OrderedDict()
        self._accounts: OrderedDict[str, _Count] = OrderedDict()

    def attempt(self, address: str, account: str, now_s: float) -> int | None:
        """Count an attempt; return None if it may be made, else the seconds to wait."""
        network = network_of(address)
        pair = _count(self._pairs, (network, account), now_s)
        of_address = _count(self._addresses, network, now_s)
        wait_s = max(pair.next_s, of_address.next_s) - now_s
        if wait_s > 0:
            return math.ceil(wait_s)
        of_account = _count(self._accounts, account, now_s)
        free = 1 if of_account.failures >= ATTACKED_AFTER else FREE_ATTEMPTS
        _fail(pair, free, MAX_DELAY_S, now_s)
        _fail(of_address, FREE_ATTEMPTS_OF_ADDRESS, MAX_DELAY_OF_ADDRESS_S, now_s)
        of_account.failures += 1
        of_account.last_s = now_s
        return None

    def succeeded(self, address: str, account: str) -> None:
        """Forget the failures of an address for an account, and one of the address and of the account."""
        network = network_of(address)
        self._pairs.pop((network, account), None)
        for counts, key in ((self._addresses, network), (self._accounts, account)):
            count = counts.get(key)
            if count is not None:
                count.failures = max(count.failures - 1, 0)
                count.next_s = 0.0


def _count(counts: OrderedDict[Key, _Count], key: Key, now_s: float) -> _Count:
    count = counts.get(key)
    if count is None:
        if len(counts) >= MAX_COUNTS:
            counts.popitem(last=False)
        count = counts[key] = _Count(last_s=now_s)
    elif now_s - count.last_s > FORGOTTEN_AFTER_S:
        count.failures, count.next_s = 0, 0.0
    counts.move_to_end(key)
    return count


def _fail(count: _Count, free: int, max_delay_s: float, now_s: float) -> None:
    count.failures += 1
    count.last_s = now_s
    over = count.failures - free
    if over >= 0:
        count.next_s = now_s + min(2.0 ** min(over, 30), max_delay_s)
