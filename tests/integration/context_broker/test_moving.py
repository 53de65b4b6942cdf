"""The commands of the README that copy all entities to another broker."""

import subprocess
from pathlib import Path
from typing import Any

from .conftest import BrokerProcess

README = Path(__file__).parents[3] / "services/context_broker/README.md"


def commands() -> str:
    """Return the commands under "Moving to another broker"."""
    section = README.read_text(encoding="utf-8").partition("## Moving to another broker\n")[2]
    indented = [line for line in section.partition("\n## ")[0].splitlines() if line.startswith("    ")]
    return "\n".join(line.removeprefix("    ") for line in indented)


def test_the_commands_of_the_readme_copy_all_entities(brokers: list[BrokerProcess], kind: str) -> None:
    source, target = brokers[0], brokers[1]
    context = {"@context": {kind: f"https://example.org/{kind}", "n": "https://example.org/n"}}
    made: list[dict[str, Any]] = [
        {"id": f"urn:ngsi-ld:{kind}:{number}", "type": kind, "n": number, **context} for number in range(1200)
    ]
    with source.client() as http:
        for start in (0, 600):
            answer = http.post(
                "/entityOperations/create",
                json=made[start : start + 600],
                headers={"Content-Type": "application/ld+json"},
            )
            assert answer.status_code == 201, answer.text
    script = commands()
    for documented, real in (("http://127.0.0.1:1026", source.url), ("http://other-host:1026", target.url)):
        assert documented in script
        script = script.replace(documented, real)
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=120, check=False)
    asked = {"type": f"https://example.org/{kind}", "limit": 1000, "local": "true", "options": "keyValues"}
    with target.client() as http:
        pages = [http.get("/entities", params={**asked, "offset": at}).json() for at in (0, 1000)]
    found = [one["https://example.org/n"] for page in pages for one in page]
    assert sorted(found) == list(range(1200)), (script, done.stderr)
