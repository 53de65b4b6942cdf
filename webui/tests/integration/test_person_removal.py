"""A Person sees who looked at the own health data, and is deleted everywhere, with what remains."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for
from webui.tests.integration.test_signing_in import Browser, invited, set_up

pytestmark = pytest.mark.slow

PERSON = "urn:ngsi-ld:Person:demo:anna"
DELETING = ("gesture-controller", "human-state", "study")


@pytest.fixture
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.start(
            "context_broker", "accounts", "gesture_controller", "human_state", "study", "webui", within_s=90
        )
        yield made


def add_person(cell: Cell, browser: Browser) -> None:
    add(browser, "PUT", "/api/gesture-controller/people/anna", {"title": "Anna"})
    add(browser, "PUT", "/api/human-state/people/anna", {})
    add(browser, "POST", "/api/study/sessions", {"pseudonym": "P-1", "person": "anna"})
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    httpx.post(url, json={"id": PERSON, "type": "Person"}, timeout=120, trust_env=False)  # may exist


def add(browser: Browser, method: str, path: str, body: dict[str, Any]) -> None:
    """Add something, once the service follows the revocations of accounts; until then it refuses changes."""
    said: list[str] = []

    def is_added() -> bool:
        answer = browser.send(method, path, body)
        said.append(answer.text)
        return answer.is_success

    wait_for(is_added, why=lambda: f"{method} {path}: {said[-1]}")


def outcomes(answer: httpx.Response) -> dict[str, str]:
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    assert [one["whyCode"].partition(".")[0] for one in found["remains"]] == ["person"] * 3
    assert all(part["detail"] for part in found["parts"] if part["outcome"] in {"refused", "unreachable"})
    return {part["service"]: part["outcome"] for part in found["parts"]}


@pytest.mark.nightly
def test_a_person_is_deleted_in_every_service_by_those_who_may(cell: Cell) -> None:
    local = Browser(cell)
    add_person(cell, local)
    first = outcomes(local.send("DELETE", "/api/persons/anna"))
    others = {"whole-body-control": "unreachable", "context-broker": "deleted"}
    assert first == {**dict.fromkeys(DELETING, "deleted"), **others}
    for path in ("gesture-controller/people/anna", "human-state/people/anna"):
        assert local.send("GET", f"/api/{path}").status_code == 404
    assert local.send("GET", "/api/study/sessions").json() == []
    assert set(outcomes(local.send("DELETE", "/api/persons/anna")).values()) == {"nothing", "unreachable"}

    add_person(cell, local)
    link = set_up(cell)
    wait_for(lambda: local.send("DELETE", "/api/persons/anna").status_code == 401)
    owner = Browser(cell)
    body = {"link": link, "name": "Olga", "password": "correct horse battery"}
    assert owner.begin("/api/session/link-use", body).status_code == 200
    vera = invited(cell, owner, "Vera", {"role": "researcher", "resource": "*"})
    adam = invited(cell, owner, "Adam", {"role": "admin", "resource": "*"})
    wait_for(lambda: vera.send("DELETE", "/api/persons/anna").status_code == 403)
    by_admin: dict[str, str] = {}

    def is_deleted() -> bool:
        by_admin.update(outcomes(adam.send("DELETE", "/api/persons/anna")))
        return by_admin["gesture-controller"] == "nothing"  # it was deleted the time before

    wait_for(is_deleted)  # services refuse changes until they follow the revocations of accounts
    assert "refused" not in by_admin.values(), "managePeople is enough in every service"
    assert set(outcomes(owner.send("DELETE", "/api/persons/anna")).values()) == {"nothing", "unreachable"}
    for service in ("webui", "accounts", "study", "human-state"):
        assert owner.send("GET", f"/api/{service}/audit/verification").json()["fault"] is None


@pytest.mark.nightly
def test_a_person_sees_who_looked_at_the_own_health_data(cell: Cell) -> None:
    local = Browser(cell)
    add_person(cell, local)
    add(local, "PUT", "/api/human-state/people/anna2", {})
    owner = Browser(cell)
    body = {"link": set_up(cell), "name": "Olga", "password": "correct horse battery"}
    assert owner.begin("/api/session/link-use", body).status_code == 200
    rosa = invited(cell, owner, "Rosa", {"role": "researcher", "resource": "*"})
    anna = invited(cell, owner, "Anna")
    subjects = {one["name"]: one["subject"] for one in owner.send("GET", "/api/accounts/users").json()}
    change = {"person": PERSON}
    assert owner.send("PATCH", f"/api/accounts/users/{subjects['Anna']}", change).status_code == 204
    path = "/api/human-state/people/anna"
    wait_for(lambda: rosa.send("GET", path).status_code == 200)
    assert rosa.send("GET", "/api/human-state/people/anna2").status_code == 200
    assert rosa.send("GET", f"{path}/accesses").status_code == 403, "it is in the audit log"
    wait_for(lambda: anna.send("GET", f"{path}/accesses").status_code == 200)
    seen = anna.send("GET", f"{path}/accesses").json()
    assert [(one["subject"], one["action"], one["isReading"]) for one in seen] == [
        (subjects["Rosa"], "GET /people/{person}", True),
        ("local", "PUT /people/{person}", False),
    ]
    assert anna.send("GET", "/api/human-state/people/anna2/accesses").status_code == 403
    assert [one["name"] for one in seen] == ["Rosa", None]
    older = anna.send("GET", f"{path}/accesses?before={seen[0]['number']}").json()
    assert older == seen[1:]
    assert owner.send("GET", f"{path}/accesses").json() == seen, "those who read the audit log see it"
    asked = f"/api/accounts/names?subject={subjects['Rosa']}&subject=local"
    assert anna.send("GET", asked).json() == {subjects["Rosa"]: "Rosa"}
    assert httpx.get(f"{cell.url('accounts')}/names?subject=x", timeout=120).status_code == 401

    assert owner.send("DELETE", f"/api/accounts/users/{subjects['Rosa']}").is_success
    assert anna.send("GET", asked).json() == {}
    names = {one["subject"]: one["name"] for one in anna.send("GET", f"{path}/accesses").json()}
    assert names[subjects["Rosa"]] == "Rosa", "the account is deleted, who looked remains"
