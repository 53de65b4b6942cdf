"""The tests that failed in the last run of a part, to be repeated alone.

python -m tests.kit.failed_tests    # those of `make test`, one id a line; fails if none or more than five
"""

import json
from collections.abc import Iterable

from tests.kit.paths import REPOSITORY

MAX_FAILED = 5
"""So many may have failed by accident, beside others on a busy machine."""
CACHES = REPOSITORY / ".pytest_cache"


def failed_in(parts: Iterable[str]) -> list[str]:
    """Return the ids of the tests that failed in the last runs of `parts`."""
    files = (CACHES / part / "v" / "cache" / "lastfailed" for part in parts)
    return sorted({test for file in files if file.exists() for test in json.loads(file.read_bytes())})


def main() -> None:
    """Print the ids."""
    failed = failed_in(path.name for path in CACHES.glob("*") if not path.name.startswith("nightly-"))
    print(*failed, sep="\n")
    if not 0 < len(failed) <= MAX_FAILED:
        raise SystemExit(f"{len(failed)} tests failed; up to {MAX_FAILED} are repeated")


if __name__ == "__main__":
    main()
