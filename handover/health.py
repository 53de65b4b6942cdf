"""Health: asks a service whether it is ready; what a container's health check runs.

`python -m handover.health http://127.0.0.1:54200/readyz` ends with 0 if the answer is a 2xx, else with 1 and
a line that says why. A word after the address names what must be true in the JSON that comes back:
`… http://gesture-controller:54210/gloves/glove-1 connected`. Only the standard library is loaded, because it
runs every few seconds beside every service.
"""

import json
import sys
import urllib.error
import urllib.request
from collections.abc import Sequence

TIMEOUT_S = 3.0
_USAGE = "usage: python -m handover.health URL [NAME OF WHAT MUST BE TRUE]"
_direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))


class NotWell(Exception):
    """What was asked is not ready; the message says why, in one line."""


def require_well(url: str, must_be_true: str | None = None) -> None:
    """Return if what answers at `url` is well; raise `NotWell` if not."""
    try:
        with _direct.open(url, timeout=TIMEOUT_S) as answer:
            body = answer.read()
    except urllib.error.HTTPError as refusal:
        with refusal:
            said = refusal.read(500).decode(errors="replace")
        raise NotWell(f"{url} answers {refusal.code}: {said}") from None
    except (OSError, ValueError) as error:
        raise NotWell(f"{url} does not answer: {getattr(error, 'reason', error)}") from None
    if must_be_true is not None:
        _require_true(url, body, must_be_true)


def _require_true(url: str, body: bytes, name: str) -> None:
    try:
        told = json.loads(body)
    except ValueError:
        raise NotWell(f"{url} does not answer with JSON, which would tell {name}") from None
    if not (isinstance(told, dict) and told.get(name) is True):
        raise NotWell(f"{url} does not say that {name} is true")


def main(words: Sequence[str]) -> int:
    """Ask as `words` say and return the exit code."""
    if not 1 <= len(words) <= 2:
        print(_USAGE, file=sys.stderr)  # noqa: T201 - read by whoever looks why a container is not healthy
        return 2
    try:
        require_well(*words)
    except NotWell as why:
        print(why, file=sys.stderr)  # noqa: T201
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
