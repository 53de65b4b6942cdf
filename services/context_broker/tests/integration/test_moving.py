"""`handover broker copy`: everything of a broker in another one, between real processes."""

import asyncio
import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover.broker_copy.copying import CopyReport, copy_broker, place_at
from handover.formats.free_values import FREE_VALUES
from handover.runtime.python_processes import module_command
from handover.security.permissions import Role
from handover.settings import Settings
from handover.subscriptions.notifications import KEY_HEADER
from handover_datamodels.contexts import HANDOVER_URL
from tests.kit import processes
from tests.kit.other_broker.profiles import ORION_LD
from tests.kit.other_broker.running import QUERY, OtherBroker
from tests.kit.other_broker.strict_broker import DATABASE_AWAY
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, wait_for

from .conftest import BrokerProcess
from .secured import secured_broker

LD = {"Content-Type": "application/ld+json"}
PLAIN_CONTEXT = {
    "n": "https://example.org/n",
    "Part": "https://example.org/Part",
    "on": "https://example.org/on",
}
CORE = "https://uri.etsi.org/ngsi-ld/"


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[BrokerProcess, BrokerProcess]]:
    """A source and a target for the tests of this module; each test has a tenant of its own."""
    made = [BrokerProcess(tmp_path_factory.mktemp(name)).start() for name in ("source", "target")]
    yield made[0], made[1]
    for broker in made:
        broker.stop()


@pytest.fixture
def tenant(kind: str) -> str:
    return f"moving_{kind}"


@pytest.fixture
def strict_broker(tmp_path: Path) -> Iterator[Callable[[], tuple[str, OtherBroker]]]:
    """Start a broker that speaks as Orion-LD; return its URL."""
    stops: list[Callable[[], None]] = []

    def start() -> tuple[str, OtherBroker]:
        port, folder = next_free_port(), tmp_path / "strict"
        folder.mkdir()
        other = OtherBroker(port, folder, ORION_LD.name, url="")
        environment = processes.clean_environment() | {"HANDOVER_DATA_DIR": str(folder)}
        front = other.spawn(environment, folder / "log")
        stops.extend([lambda: processes.stop(front), other.stop])
        url = f"http://127.0.0.1:{port}"
        processes.wait_ready(front, url + QUERY, lambda: (folder / "log").read_text(errors="replace"))
        return url, other

    yield start
    for stop in stops:
        stop()


def command(folder: Path, *words: str) -> subprocess.Popen[str]:
    """Start `handover broker copy`."""
    return subprocess.Popen(
        [*module_command("handover_cell"), "broker", "copy", *words],
        env=processes.clean_environment() | {"HANDOVER_DATA_DIR": str(folder)},
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def copied(folder: Path, *words: str) -> tuple[int, dict[str, Any], str]:
    """Copy; return the exit code, the summary and the progress."""
    with command(folder, *words, "--json") as process:
        out, errors = process.communicate(timeout=scaled(240))
    assert "Traceback" not in errors, errors
    return process.returncode, json.loads(out) if out else {}, errors


def create(url: str, entities: list[dict[str, Any]], tenant: str | None = None, context: Any = None) -> None:
    headers = {**LD, **({"NGSILD-Tenant": tenant} if tenant else {})}
    with httpx.Client(base_url=f"{url}/ngsi-ld/v1", timeout=120, trust_env=False, headers=headers) as http:
        for start in range(0, len(entities), 500):
            body = [
                {"@context": context or PLAIN_CONTEXT, **entity} for entity in entities[start : start + 500]
            ]
            answer = http.post("/entityOperations/create", json=body)
            assert answer.status_code == 201, answer.text


def parts(count: int) -> list[dict[str, Any]]:
    return [
        {"id": f"urn:ngsi-ld:Part:{number}", "type": "Part", "n": {"type": "Property", "value": number}}
        for number in range(count)
    ]


def ask(broker: BrokerProcess | str, tenant: str = "", **headers: str) -> httpx.Client:
    url = broker if isinstance(broker, str) else broker.url
    named = {**headers, **({"NGSILD-Tenant": tenant} if tenant else {})}
    return httpx.Client(base_url=f"{url}/ngsi-ld/v1", timeout=120, trust_env=False, headers=named)


def count_of(broker: BrokerProcess, tenant: str) -> int:
    with ask(broker, tenant) as http:
        answer = http.get("/entities", params={"local": "true", "limit": 1, "count": "true"})
    return int(answer.headers.get("ngsild-results-count", 0))


def link(context_url: str) -> str:
    return f'<{context_url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'


@pytest.mark.nightly
def test_all_tenants_are_copied_with_documents_and_a_second_copy_finds_all_equal(tmp_path: Path) -> None:
    brokers = [BrokerProcess(tmp_path / name) for name in ("from", "to")]
    try:
        for broker in brokers:
            broker.data_dir.mkdir()
            broker.start()
        source, target = brokers
        create(source.url, parts(230))
        create(source.url, parts(3), "clinic")
        create(source.url, [{"id": "urn:ngsi-ld:Task:1", "type": "Task", "name": "weld"}], "line-2")
        with ask(source, **LD) as http:
            added = http.post("/jsonldContexts", json={"@context": PLAIN_CONTEXT})
            hosted = str(added.url.join(added.headers["location"]))
            for name, context in (("hosted", hosted), ("given", PLAIN_CONTEXT)):
                subscription = {
                    "@context": context,
                    "id": f"urn:ngsi-ld:Subscription:{name}",
                    "type": "Subscription",
                    "entities": [{"type": "Part"}],
                    "watchedAttributes": ["n"],
                    "q": "n>5",
                    "throttling": 5,
                    "notification": {
                        "attributes": ["n"],
                        "format": "keyValues",
                        "endpoint": {"uri": "http://127.0.0.1:9/notify", "accept": "application/json"},
                    },
                }
                assert http.post("/subscriptions", json=subscription).status_code == 201
            registration = {
                "@context": PLAIN_CONTEXT,
                "id": "urn:ngsi-ld:ContextSourceRegistration:1",
                "type": "ContextSourceRegistration",
                "information": [{"entities": [{"type": "Part"}], "propertyNames": ["on"]}],
                "endpoint": "http://127.0.0.1:9",
            }
            assert http.post("/csourceRegistrations", json=registration).status_code == 201
        code, summary, progress = copied(tmp_path, source.url, target.url)
        assert code == 0, (summary, progress)
        assert [(one["tenant"], one["entities"]["created"]) for one in summary["tenants"]] == [
            ("", 230),
            ("clinic", 3),
            ("line-2", 1),
        ]
        assert summary["history"] == "notCopied"
        default = summary["tenants"][0]
        new = default["contextAddresses"][hosted]
        with ask(target, Link=link(new)) as http:
            assert http.get(new).json() == {"@context": PLAIN_CONTEXT}
            for name in ("hosted", "given"):
                stored = http.get(f"/subscriptions/urn:ngsi-ld:Subscription:{name}").json()
                assert stored["entities"] == [{"type": "Part"}]
                assert (stored["watchedAttributes"], stored["q"]) == (["n"], "n>5")
                # notifications have the same short names, and the source is not needed for them
                assert stored["jsonldContext"].startswith(target.url)
                assert http.get(stored["jsonldContext"]).json()["@context"] == PLAIN_CONTEXT
            found = http.get("/csourceRegistrations/urn:ngsi-ld:ContextSourceRegistration:1").json()
            assert found["information"] == registration["information"]

        again, summary, progress = copied(tmp_path, source.url, target.url)
        assert again == 0, (summary, progress)
        default = summary["tenants"][0]
        assert (default["entities"]["created"], default["entities"]["present"]) == (0, 230)
        assert (default["subscriptions"]["created"], default["subscriptions"]["equal"]) == (0, 2)
        assert (default["registrations"]["created"], default["contexts"]["created"]) == (0, 0)
    finally:
        for broker in brokers:
            broker.stop()


@pytest.mark.nightly
def test_a_killed_copy_is_finished_by_the_same_command(
    pair: tuple[BrokerProcess, BrokerProcess], tenant: str, tmp_path: Path
) -> None:
    source, target = pair
    create(source.url, parts(4000), tenant)
    words = (source.url, target.url, "--tenant", tenant, "--only")
    with command(tmp_path, *words) as process:
        wait_for(lambda: count_of(target, tenant) > 0, why="nothing was copied")
        assert target.process is not None
        target.process.send_signal(signal.SIGSTOP)  # the copy waits for it, and is killed in the middle
        try:
            assert process.poll() is None
            process.kill()
            process.wait(scaled(60))
        finally:
            target.process.send_signal(signal.SIGCONT)
    before = count_of(target, tenant)
    assert 0 < before < 4000
    code, summary, progress = copied(tmp_path, *words)
    assert code == 0, progress
    entities = summary["tenants"][0]["entities"]
    assert entities["equal"] == 4000
    assert entities["present"] >= before  # a batch under way may have been done after the count
    assert entities["created"] + entities["present"] == 4000


@pytest.mark.nightly
def test_what_a_target_refuses_or_changes_is_reported_by_entity_and_attribute(
    pair: tuple[BrokerProcess, BrokerProcess],
    tenant: str,
    tmp_path: Path,
    strict_broker: Callable[[], tuple[str, OtherBroker]],
) -> None:
    source, _ = pair
    target, _ = strict_broker()
    tenant = tenant.lower()
    instances = [{"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "urn:d:1"}]
    text = "x" * 700_000
    named: dict[str, dict[str, Any]] = {
        "instances": {"n": instances},
        "list-property": {"n": {"type": "ListProperty", "valueList": [1, 2]}},
        "integer": {"n": {"type": "Property", "value": 1764408000000}},
        "list-of-one": {"n": {"type": "Property", "value": [5]}},
        "core-term": {"start": {"type": "Property", "value": 1}},
        "large-1": {"n": {"type": "Property", "value": text}},
        "large-2": {"n": {"type": "Property", "value": text}},
        "too-large": {"n": {"type": "Property", "value": text + text}},
        "place": {
            "location": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [8.5, 50.1]}}
        },
    }
    made = [
        {"id": f"urn:ngsi-ld:Part:{name}", "type": "Part", **attributes} for name, attributes in named.items()
    ]
    create(source.url, made, tenant)
    create(source.url, [{**one, "id": f"urn:ngsi-ld:Part:{at}"} for at, one in enumerate(parts(150))], tenant)
    with ask(source, tenant, **LD) as http:
        for name, more in (("plain", {}), ("trigger", {"notificationTrigger": ["entityCreated"]})):
            subscription = {
                "@context": PLAIN_CONTEXT,
                "id": f"urn:ngsi-ld:Subscription:{name}",
                "type": "Subscription",
                "entities": [{"type": "Part"}],
                "q": "n>5",
                "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notify"}},
                **more,
            }
            assert http.post("/subscriptions", json=subscription).status_code == 201
    words = (source.url, target, "--tenant", tenant, "--only")
    for _ in range(2):  # what was reported is reported again, and nothing else has changed
        code, summary, progress = copied(tmp_path, *words)
        assert code == 1, progress
        (entry,) = summary["tenants"]
        problems = {one["id"].rpartition(":")[2]: one for one in entry["problems"]}
        assert summary["error"] is None
        refused = {"list-property", "too-large", "trigger"}
        assert set(problems) == {*refused, "integer", "list-of-one"}, progress
        assert "501" in problems["trigger"]["problem"] or "Not Implemented" in problems["trigger"]["problem"]
        assert entry["subscriptions"]["equal"] == 1
        assert "ListProperty" in problems["list-property"]["reason"]
        assert "413" in problems["too-large"]["reason"]
        assert problems["integer"]["attribute"] == "https://example.org/n"
        assert problems["integer"]["source"]["value"] == 1764408000000
        assert problems["integer"]["target"]["value"] == -823558656
        assert (problems["list-of-one"]["source"]["value"], problems["list-of-one"]["target"]["value"]) == (
            [5],
            5,
        )
        assert entry["entities"]["equal"] == len(named) + 150 - 4
        with ask(target, tenant) as http:
            found = http.get("/entities/urn:ngsi-ld:Part:instances").json()
            assert found["https://example.org/n"] == instances


@pytest.mark.nightly
def test_parameters_of_tasks_are_kept_on_the_way_to_another_broker_and_back(
    pair: tuple[BrokerProcess, BrokerProcess],
    tenant: str,
    tmp_path: Path,
    strict_broker: Callable[[], tuple[str, OtherBroker]],
) -> None:
    source, back = pair
    other, _ = strict_broker()
    tenant = tenant.lower()
    values = [{"at": 1764408000000, "steps": ["one"]}, {"steps": ["one", "two"]}]
    tasks = [
        {
            "id": f"urn:ngsi-ld:Task:demo:{at}",
            "type": "Task",
            **{name: {"type": "Property", "value": value} for name in FREE_VALUES},
        }
        for at, value in enumerate(values)
    ]
    create(source.url, tasks, tenant, context=HANDOVER_URL)
    for here, there in ((source.url, other), (other, back.url)):
        for _ in range(2):
            code, _, progress = copied(tmp_path, here, there, "--tenant", tenant, "--only")
            assert code == 0, progress
    for at, value in enumerate(values):
        path = f"/entities/urn:ngsi-ld:Task:demo:{at}"
        with ask(other, tenant) as http:
            text = http.get(path).text
        with ask(back, tenant) as http:
            found = http.get(path).json()
        assert [found[name]["value"] for name in FREE_VALUES] == [value, value]
        assert "asText" not in str(found)
        assert ("asText" in text) is (at == 0)


@pytest.mark.nightly
def test_another_content_in_the_target_is_replaced_only_if_wanted(
    pair: tuple[BrokerProcess, BrokerProcess], tenant: str, tmp_path: Path
) -> None:
    source, target = pair
    create(source.url, parts(5), tenant)
    create(target.url, [{**parts(2)[1], "n": {"type": "Property", "value": "mine"}}], tenant)
    create(target.url, [{**parts(1)[0], "id": "urn:ngsi-ld:Part:theirs"}], tenant)
    words = (source.url, target.url, "--tenant", tenant, "--only")
    code, summary, _ = copied(tmp_path, *words)
    problems = {one["id"]: one for one in summary["tenants"][0]["problems"]}
    assert code == 1
    assert problems["urn:ngsi-ld:Part:1"]["target"]["value"] == "mine"
    assert problems["urn:ngsi-ld:Part:theirs"]["isOnlyInTarget"]
    assert len(problems) == 2
    code, summary, _ = copied(tmp_path, *words, "--overwrite")
    problems = {one["id"]: one for one in summary["tenants"][0]["problems"]}
    assert (code, set(problems)) == (1, {"urn:ngsi-ld:Part:theirs"})
    assert summary["tenants"][0]["entities"]["replaced"] == 1
    with ask(target, tenant) as http:
        assert http.delete("/entities/urn:ngsi-ld:Part:theirs").status_code == 204
    assert copied(tmp_path, *words)[0] == 0


@pytest.mark.nightly
def test_a_secret_that_cannot_be_read_is_for_a_person_and_own_subscriptions_are_for_the_services(
    pair: tuple[BrokerProcess, BrokerProcess], tenant: str, tmp_path: Path
) -> None:
    source, target = pair
    create(source.url, parts(1), tenant)

    def subscription(name: str, key: str) -> dict[str, Any]:
        pair_of_key = {"key": key, "value": "0123456789abcdef"}
        return {
            "@context": PLAIN_CONTEXT,
            "id": f"urn:ngsi-ld:Subscription:{name}",
            "type": "Subscription",
            "entities": [{"type": "Part"}],
            "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notify", "receiverInfo": [pair_of_key]}},
        }

    mes = subscription("mes", "Authorization")
    with ask(source, tenant, **LD) as http:
        for one in (mes, subscription("demo:webui", KEY_HEADER)):
            assert http.post("/subscriptions", json=one).status_code == 201
    words = (source.url, target.url, "--tenant", tenant, "--only")
    code, summary, progress = copied(tmp_path, *words)
    (problem,) = summary["tenants"][0]["problems"]
    assert (code, problem["id"]) == (1, "urn:ngsi-ld:Subscription:mes")
    assert "must be made by hand, since receiverInfo Authorization" in problem["problem"]
    assert "urn:ngsi-ld:Subscription:demo:webui is skipped" in progress
    with ask(target, tenant, **LD) as http:
        assert http.get("/subscriptions").json() == []
        assert http.post("/subscriptions", json=mes).status_code == 201
    assert copied(tmp_path, *words)[0] == 0


@pytest.mark.nightly
def test_a_broker_that_is_away_or_empty_is_no_success(
    pair: tuple[BrokerProcess, BrokerProcess],
    tenant: str,
    tmp_path: Path,
    strict_broker: Callable[[], tuple[str, OtherBroker]],
) -> None:
    source, target = pair
    code, summary, _ = copied(tmp_path, source.url, target.url, "--tenant", f"no_{tenant}", "--only")
    assert (code, summary["isEqual"]) == (1, False)
    assert "has nothing" in summary["error"]
    nowhere = f"http://127.0.0.1:{next_free_port()}"
    code, summary, _ = copied(tmp_path, source.url, nowhere)
    assert code == 1
    assert "does not answer" in summary["error"]
    assert copied(tmp_path, source.url, source.url)[0] == 2
    # a broker whose database is away answers with an empty list
    url, other = strict_broker()
    create(url, parts(3))
    (other.folder / DATABASE_AWAY).touch()
    code, summary, _ = copied(tmp_path, url, target.url)
    assert (code, summary["isEqual"]) == (1, False)
    (other.folder / DATABASE_AWAY).unlink()
    lower = tenant.lower()
    create(url, parts(3), lower)
    assert copied(tmp_path, url, target.url, "--tenant", lower, "--only")[0] == 0


@pytest.mark.nightly
def test_a_target_that_goes_away_is_named_with_the_way_out(
    pair: tuple[BrokerProcess, BrokerProcess], tenant: str, tmp_path: Path
) -> None:
    source, _ = pair
    create(source.url, parts(3000), tenant)
    (tmp_path / "broker").mkdir()
    target = BrokerProcess(tmp_path / "broker").start()
    words = (source.url, target.url, "--tenant", tenant, "--only")
    try:
        with command(tmp_path, *words, "--json") as process:
            wait_for(lambda: count_of(target, tenant) > 0, why="nothing was copied")
            target.kill()
            out, errors = process.communicate(timeout=scaled(240))
        assert process.returncode == 1, errors
        assert "same command again" in json.loads(out)["error"]
        target.start()
        assert copied(tmp_path, *words)[0] == 0
    finally:
        target.stop()


def test_with_accounts_a_token_has_to_have_the_rights(
    tmp_path: Path, pair: tuple[BrokerProcess, BrokerProcess], tenant: str
) -> None:
    with secured_broker(tmp_path / "cell") as secured:
        url = secured.cell.url("context_broker")
        with secured.service(**LD, **{"NGSILD-Tenant": tenant}) as http:
            for kind in ("Part", "HumanState", "Person"):
                entity = {"@context": HANDOVER_URL, "id": f"urn:ngsi-ld:{kind}:demo:1", "type": kind}
                assert http.post("/entities", json=entity).status_code == 201
        words = (url, pair[1].url, "--tenant", tenant, "--only")
        code, summary, _ = copied(tmp_path, *words)
        assert code == 1
        assert "--from-token-file" in summary["error"]
        assert summary["tenants"] == [] or not summary["tenants"][0]["entities"]["created"]
        # the names of tenants are for callers with the rights for all of them
        extras = [
            secured.caller(*roles).get("/info/sourceIdentity").json()["contextSourceExtras"]
            for roles in ((Role.VIEWER,), (Role.ENGINEER,))
        ]
        assert [one.get("tenants") for one in extras] == [None, [tenant]]
        _, token = secured.script(Role.ADMIN, Role.ENGINEER, Role.RESEARCHER)
        (tmp_path / "token").write_text(token)
        code, summary, progress = copied(tmp_path, *words, "--from-token-file", str(tmp_path / "token"))
        assert (code, summary["tenants"][0]["entities"]["equal"]) == (0, 3), progress


# Any entity

IRIS = st.sampled_from(
    [
        "https://example.org/a",
        "https://example.org/b,c",
        "https://example.org/d#e",
        "urn:example:f",
        f"{CORE}default-context/g",
        f"{CORE}default-context/https",
        f"{CORE}name",
        f"{CORE}start",
        f"{CORE}unitCode",
        f"{CORE}scope",
        f"{CORE}createdAt",
        f"{CORE}hasObject",
        "https://schema.org/name",
        "http://purl.org/dc/terms/title",
        f"{CORE}location2",
    ]
)
TERMS = ("t", "u", "v", "w")
CONTEXTS = st.dictionaries(st.sampled_from(TERMS), IRIS, max_size=4)
NUMBERS = st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.recursive(
    st.booleans() | NUMBERS | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(("type", "value", "observedAt", "a", "@type")), inner, max_size=3)
    ),
    max_leaves=6,
)
URIS = st.sampled_from(["urn:x:1", "https://example.org/x?y=1,2", "urn:ngsi-ld:Part:é"])
BARE = st.one_of(
    st.builds(lambda value: {"type": "Property", "value": value}, VALUES),
    st.builds(
        lambda uri: {"type": "Relationship", "object": uri}, URIS | st.lists(URIS, min_size=1, max_size=2)
    ),
    st.builds(
        lambda point: {"type": "GeoProperty", "value": {"type": "Point", "coordinates": list(point)}},
        st.tuples(st.integers(-180, 180), st.floats(-90, 90)),
    ),
    st.builds(
        lambda text: {"type": "LanguageProperty", "languageMap": {"en": text, "fi": [text]}}, st.text()
    ),
    st.builds(lambda json: {"type": "JsonProperty", "json": {"x": json}}, VALUES),
    st.builds(lambda words: {"type": "VocabProperty", "vocab": words}, st.sampled_from(TERMS) | IRIS),
    st.builds(lambda value: {"type": "ListProperty", "valueList": value}, st.lists(VALUES, max_size=3)),
    st.builds(
        lambda uris: {"type": "ListRelationship", "objectList": [{"object": one} for one in uris]},
        st.lists(URIS, min_size=1, max_size=2),
    ),
)
METADATA = st.fixed_dictionaries(
    {},
    optional={
        "observedAt": st.sampled_from(["2026-01-01T00:00:00Z", "2026-01-01T01:00:00.25+01:00"]),
        "unitCode": st.text("ABC", min_size=1, max_size=3),
        "valueType": st.sampled_from(TERMS),
        "objectType": st.sampled_from(TERMS),
        "expiresAt": st.just("2190-01-01T00:00:00Z"),
    },
)
NAMES = st.sampled_from(TERMS) | IRIS
ATTRIBUTE = st.builds(
    lambda bare, metadata, below: {**below, **metadata, **bare},
    BARE,
    METADATA,
    st.dictionaries(NAMES, BARE, max_size=2),
)
INSTANCES = st.builds(
    lambda ones: [
        one if at == 0 else {**one, "datasetId": f"urn:ngsi-ld:Dataset:{at}"} for at, one in enumerate(ones)
    ],
    st.lists(ATTRIBUTE, min_size=2, max_size=3),
)
ENTITIES = st.builds(
    lambda context, kinds, members, attributes: {
        "@context": context,
        "type": kinds,
        **attributes,
        **members,
    },
    CONTEXTS,
    NAMES | st.lists(NAMES, min_size=1, max_size=3, unique=True),
    st.fixed_dictionaries(
        {},
        optional={
            "scope": st.sampled_from(["/a", ["/a/b", "/c"]]),
            "expiresAt": st.just("2190-01-01T00:00:00Z"),
        },
    ),
    st.dictionaries(NAMES, ATTRIBUTE | INSTANCES, max_size=4),
)
IDS = st.sampled_from(
    ["urn:ngsi-ld:Part:1", "urn:ngsi-ld:Part:é,1", "https://example.org/part?a=b&c", "urn:x:%2F"]
)


def stripped(value: Any) -> Any:
    """Return the answer of a broker without the times of its writes."""
    if isinstance(value, dict):
        return {name: stripped(one) for name, one in value.items() if name not in {"createdAt", "modifiedAt"}}
    return [stripped(one) for one in value] if isinstance(value, list) else value


NUMBER = iter(range(10**9))


@pytest.mark.nightly
@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(made=st.dictionaries(IDS, ENTITIES, min_size=1, max_size=4))
def test_any_entity_is_the_same_after_a_copy(
    pair: tuple[BrokerProcess, BrokerProcess], made: dict[str, dict[str, Any]]
) -> None:
    source, target = pair
    tenant = f"any_{next(NUMBER)}"
    with ask(source, tenant, **LD) as http:
        accepted = [
            name
            for name, entity in made.items()
            if http.post("/entities", content=json.dumps({**entity, "id": name})).status_code == 201
        ]
    if not accepted:
        return

    async def copy() -> CopyReport:
        places = [await place_at(Settings.load(broker_url=broker.url), None) for broker in pair]
        return await copy_broker(places[0], places[1], [tenant], lambda _: None)

    report = asyncio.run(copy())
    assert report.is_equal, report.as_json()
    assert report.tenants[0].entities.equal == len(accepted)
    for context in ("https://w3id.org/handover/context.jsonld", f"{CORE}v1/ngsi-ld-core-context-v1.8.jsonld"):
        headers = {"Link": link(context)}
        with ask(source, tenant, **headers) as first, ask(target, tenant, **headers) as second:
            asked = {"local": "true", "options": "sysAttrs"}
            listed = [http.get("/entities", params=asked).json() for http in (first, second)]
            found = [{one["id"]: stripped(one) for one in entities} for entities in listed]
            assert found[0] == found[1]
            assert set(found[0]) == set(accepted)
