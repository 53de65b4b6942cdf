"""The tests that failed in the last run of each part, to be repeated alone.

python -m tests.kit.failed_tests    # one id a line; fails if there are none, or more than five
"""

import json

from tests.kit.paths import REPOSITORY

MAX_FAILED = 5


def main() -> None:
    """Print the ids."""
    files = sorted((REPOSITORY / ".pytest_cache").glob("*/v/cache/lastfailed"))
    failed = sorted({test for file in files for test in json.loads(file.read_text(encoding="utf-8"))})
    print(*failed, sep="\n")
    if not 0 < len(failed) <= MAX_FAILED:
        raise SystemExit(f"{len(failed)} tests failed; up to {MAX_FAILED} are repeated")


if __name__ == "__main__":
    main()
