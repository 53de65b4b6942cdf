"""Write the JSON Schema files, or check with `--check` whether they are current."""

import argparse
import sys

from handover_datamodels import schemas


def main(arguments: list[str] | None = None) -> int:
    """Write or check the files; return 1 if `--check` finds one that is not current."""
    parser = argparse.ArgumentParser(prog="python -m handover_datamodels.schemas", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a file is not current")
    if not parser.parse_args(arguments).check:
        for path in schemas.write():
            sys.stdout.write(f"wrote {path.name}\n")
        return 0
    stale = schemas.outdated()
    for path in stale:
        sys.stderr.write(f"{path.name} differs from the models; run python -m handover_datamodels.schemas\n")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
