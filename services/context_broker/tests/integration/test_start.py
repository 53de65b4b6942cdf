"""The start needs no network, and imports nothing that is slow and rarely used."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

NO_TIME_S = 0.0001
"""For contexts that must be fetched: a successful response did not need the network."""
CORE = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context{}.jsonld"
CONTEXTS = [
    *(CORE.format(version) for version in ("", "-v1.3", "-v1.5", "-v1.6", "-v1.7", "-v1.8")),
    "https://smartdatamodels.org/context.jsonld",
    "https://w3id.org/handover/context.jsonld",
]
SELDOM = ("shapely", "lxml", "psycopg", "numpy", "scipy")

in_a_file = pytest.mark.parametrize("own_broker", ["sqlite"], indirect=True)


@in_a_file
def test_common_contexts_need_no_network(own_broker: Any) -> None:
    own_broker.extra["HANDOVER_BROKER_CONTEXT_TIMEOUT_S"] = str(NO_TIME_S)
    own_broker.start()
    linked = {"Content-Type": "application/ld+json"}
    with own_broker.client() as http:
        for number, context in enumerate([*CONTEXTS, CONTEXTS]):
            entity = {"id": f"urn:x:{number}", "type": "Machine", "speed": 1, "@context": context}
            answer = http.post("/entities", content=json.dumps(entity), headers=linked)
            assert answer.status_code == 201, answer.text
        for number, context in enumerate(CONTEXTS):
            link = f'<{context}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
            answer = http.get(f"/entities/urn:x:{number}", headers={"Link": link})
            assert answer.json()["speed"]["value"] == 1, answer.text
        entity = {"id": "urn:x:other", "type": "Machine", "@context": "http://192.0.2.1/other.jsonld"}
        answer = http.post("/entities", content=json.dumps(entity), headers=linked)
        assert answer.status_code == 504, "this one had to be fetched"


@pytest.mark.nightly
@in_a_file
def test_rarely_used_modules_are_not_loaded_at_the_start(own_broker: Any) -> None:
    own_broker.is_forked = False
    own_broker.start()
    loaded = Path(f"/proc/{own_broker.process.pid}/maps")
    if not loaded.exists():
        pytest.skip("only Linux lists what a process has loaded")
    assert "site-packages/orjson" in loaded.read_text()
    assert not [name for name in SELDOM if f"site-packages/{name}" in loaded.read_text()]


@pytest.mark.nightly
def test_a_start_does_not_wait_for_the_web_framework() -> None:
    started = "import sys, handover_broker.app, handover.serving.server; print('fastapi' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", started], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "False"


@in_a_file
def test_health_and_metrics_are_there_though_they_are_loaded_later(own_broker: Any) -> None:
    own_broker.start()
    with own_broker.client() as http:
        assert http.get("/types").status_code == 200
        root = str(http.base_url).partition("/ngsi-ld")[0]
        for path in ("/healthz", "/readyz", "/metrics", "/context.jsonld", "/docs"):
            assert http.get(f"{root}{path}").status_code == 200, path
        assert http.get(f"{root}/nothing").json()["title"] == "Not Found"
