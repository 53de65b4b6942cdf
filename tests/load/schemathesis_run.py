"""Schemathesis against every service of a cell, each as a process, without accounts.

    python -m tests.load.schemathesis_run PROGRAM [--examples 20] [--service study] [--seed 7]

Schemathesis reads the OpenAPI document of a service, sends requests that match it and requests that do not,
and compares the responses with it. PROGRAM is `schemathesis` of an environment of its own. Exits with 1 and
names the services with faults.

Left out: what ends the cell, and streams. 501 to 504 are no faults: a robot or sensor is not there. A valid
request may be refused, since rules between fields stand in no schema (`positive_data_acceptance`). An invalid
one may be refused for its size (413), before it is read.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.integration.cell.test_perimeter import SERVICES
from tests.kit.cell import new_cell
from tests.kit.described_requests import KEPT_RUNNING

STREAMS = ("/frames",)
"""Ends of paths whose response does not end."""
CONFIGURATION = """\
[checks.positive_data_acceptance]
enabled = false

[checks.not_a_server_error]
expected-statuses = ["2xx", "3xx", "4xx", 501, 502, 503, 504]

[checks.negative_data_rejection]
expected-statuses = [400, 401, 403, 404, 405, 406, 409, 413, 415, 422, 428, 429, "5xx"]
"""
SETTINGS = {
    "HANDOVER_ASSISTIVE_MACHINES": "bed",
    "HANDOVER_HUMANOID_MODEL": "coman",
    "HANDOVER_HUMANOID_FIFO": "false",
}
REQUEST_TIMEOUT_S = 120


def main() -> None:
    """Test the services; exit with 1 if one has a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.load.schemathesis_run", description=__doc__)
    parser.add_argument("program", help="schemathesis of an environment of its own")
    parser.add_argument("--examples", type=int, default=20, help="requests by chance for each operation")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--service", choices=SERVICES, action="append", help="only this one; may be repeated")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, new_cell(Path(folder)) as cell:
        configuration = Path(folder) / "schemathesis.toml"
        configuration.write_text(CONFIGURATION)
        cell.extra |= SETTINGS
        cell.start(*SERVICES, within_s=90.0)
        faulty = []
        for service in options.service or SERVICES:
            command = [options.program, "--config-file", str(configuration), "run"]
            command += [f"{cell.url(service)}/openapi.json", "--phases", "coverage,fuzzing"]
            command += ["--max-examples", str(options.examples), "--seed", str(options.seed)]
            command += ["--continue-on-failure", "--warnings", "off", "--wait-for-schema", "120"]
            command += ["--generation-database", "none", "--request-timeout", str(REQUEST_TIMEOUT_S)]
            command += ["--suppress-health-check", "all"]
            command += ["--exclude-path-regex", "|".join([*KEPT_RUNNING, *(f"{path}$" for path in STREAMS)])]
            print(f"\n{service}", flush=True)
            if subprocess.run(command, check=False).returncode != 0 or not cell.runs(service):
                faulty.append(service)
    sys.exit(f"schemathesis: faults in {', '.join(faulty)}" if faulty else 0)


if __name__ == "__main__":
    main()
