"""Health: checks whether a service is ready; the health check of containers.

`python -m handover.health http://127.0.0.1:54200/readyz` ends with 0 if the answer is a 2xx, else with 1 and
a line with the reason. A second argument names a member of the JSON response that must be true:
`… http://gesture-controller:54210/gloves/glove-1 connected`. It imports only the standard library, because
it runs every few seconds beside every service.
"""

import json
import os
import ssl
import sys
import urllib.error
import urllib.request
from collections.abc import Sequence
from pathlib import Path

TIMEOUT_S = 3.0
_USAGE = "usage: python -m handover.health URL [MEMBER]"
AUTHORITY = "HANDOVER_TLS_AUTHORITY"
"""The environment variable with the authorities that are trusted besides those of the system."""
SERVICE_FILE = "HANDOVER_SERVICE_TOKEN_FILE"
"""The environment variable with the file of the token of this service."""


class NotReady(Exception):
    """The service is not ready; the message is the reason in one line."""


def require_ready(url: str, must_be_true: str | None = None) -> None:
    """Raise `NotReady` if the service at `url` is not ready."""
    try:
        with _opener(url, is_public=must_be_true is None).open(url, timeout=TIMEOUT_S) as answer:
            body = answer.read()
    except urllib.error.HTTPError as refusal:
        with refusal:
            detail = refusal.read(500).decode(errors="replace")
        raise NotReady(f"{url} answers {refusal.code}: {detail}") from None
    except (OSError, ValueError) as error:
        raise NotReady(f"{url} does not answer: {getattr(error, 'reason', error)}") from None
    if must_be_true is not None:
        _require_true(url, body, must_be_true)


def _opener(url: str, *, is_public: bool) -> urllib.request.OpenerDirector:
    """Return an opener that uses no proxy, and identifies this service for what is not public."""
    handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({})]
    if url.startswith("https:"):
        context = ssl.create_default_context()
        authority = os.environ.get(AUTHORITY)
        if authority:
            context.load_verify_locations(authority)
        handlers.append(urllib.request.HTTPSHandler(context=context))
    opener = urllib.request.build_opener(*handlers)
    file = os.environ.get(SERVICE_FILE)
    if file and not is_public:
        opener.addheaders = [("Authorization", f"Bearer {Path(file).read_text(encoding='utf-8').strip()}")]
    return opener


def _require_true(url: str, body: bytes, name: str) -> None:
    try:
        answer = json.loads(body)
    except ValueError:
        raise NotReady(f"{url} does not answer with JSON, so {name} is unknown") from None
    if not (isinstance(answer, dict) and answer.get(name) is True):
        raise NotReady(f"{url}: {name} is not true")


def main(words: Sequence[str]) -> int:
    """Check with the arguments `words` and return the exit code."""
    if not 1 <= len(words) <= 2:
        print(_USAGE, file=sys.stderr)  # noqa: T201 - the output of a health check
        return 2
    try:
        require_ready(*words)
    except NotReady as why:
        print(why, file=sys.stderr)  # noqa: T201
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
