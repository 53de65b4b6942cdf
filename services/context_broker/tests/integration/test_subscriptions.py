"""Subscriptions over HTTP: creation, reading, changes, deletion and errors."""

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

ENDPOINT = {"uri": "http://127.0.0.1:9/notify", "accept": "application/json"}


def wish(name: str, **members: Any) -> dict[str, Any]:
    return {
        "id": f"urn:ngsi-ld:Subscription:demo:{name}",
        "type": "Subscription",
        "entities": [{"type": "Task"}],
        "notification": {"endpoint": ENDPOINT},
        **members,
    }


def mqtt(key: str, value: str) -> dict[str, Any]:
    return {"uri": "mqtt://a.example/topic", "notifierInfo": [{"key": key, "value": value}]}


def made(http: httpx.Client, name: str, **members: Any) -> str:
    answer = http.post("/subscriptions", json=wish(name, **members))
    assert answer.status_code == 201, answer.text
    return f"/subscriptions/{wish(name)['id']}"


@pytest.mark.nightly
def test_a_subscription_is_read_back_as_it_was(http: httpx.Client) -> None:
    given = wish(
        "full",
        subscriptionName="all of it",
        description="what a subscription can say",
        entities=[{"type": "Task", "idPattern": ".*demo.*"}, {"id": "urn:x:1", "type": "Device"}],
        watchedAttributes=["status", "requestedStatus"],
        q='status=="pending"',
        throttling=2,
        expiresAt="2999-01-01T00:00:00Z",
        isActive=True,
        notificationTrigger=["entityCreated", "attributeDeleted"],
        geoQ={"georel": "near;maxDistance==20", "geometry": "Point", "coordinates": [8, 40]},
        scopeQ="/hall/#",
        csf="endpoint",
        lang="fr,en;q=0.5",
        datasetId=["@none"],
        localOnly=True,
        notification={
            "attributes": ["status"],
            "format": "concise",
            "sysAttrs": True,
            "showChanges": True,
            "join": "inline",
            "joinLevel": 2,
            "endpoint": {
                **ENDPOINT,
                "timeout": 2000,
                "cooldown": 500,
                "receiverInfo": [{"key": "X-Cell", "value": "4"}],
                "notifierInfo": [{"key": "Prefer", "value": "body=json"}],
            },
        },
    )
    answer = http.post("/subscriptions", json=given)
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/ngsi-ld/v1/subscriptions/{given['id']}"
    kept = http.get(f"/subscriptions/{given['id']}").json()
    assert kept.pop("status") == "active"
    kept.pop("jsonldContext")
    given["notification"]["endpoint"]["receiverInfo"] = [{"key": "X-Cell", "value": "********"}]
    assert kept == given, "the values of headers are write-only"


def test_periodic_and_picked_subscriptions_are_read_back(http: httpx.Client) -> None:
    given = wish(
        "periodic",
        entities=[{"type": "(Device;Asset),Task"}],
        timeInterval=3600,
        notification={"endpoint": ENDPOINT, "pick": ["id", "status"]},
    )
    assert http.post("/subscriptions", json=given).status_code == 201
    kept = http.get(f"/subscriptions/{given['id']}").json()
    assert kept["timeInterval"] == 3600
    assert kept["notification"]["pick"] == ["id", "status"]
    assert kept["entities"] == [{"type": "(Asset;Device),Task"}]


@pytest.mark.parametrize(
    "members",
    [
        {"splitEntities": True},
        {"ngsildConformance": "1.6"},
        {"q": "category==red", "expandValues": "category", "jsonKeys": "raw"},
        {"localOnly": True, "entities": None},
        {"datasetId": ["@none"]},
    ],
)
def test_members_that_came_later_are_read_back(http: httpx.Client, members: dict[str, Any]) -> None:
    given = {name: said for name, said in (wish("later") | members).items() if said is not None}
    assert http.post("/subscriptions", json=given).status_code == 201
    kept = http.get(f"/subscriptions/{given['id']}").json()
    assert http.delete(f"/subscriptions/{given['id']}").status_code == 204
    assert given.items() <= {**kept, "notification": given["notification"]}.items()


def test_a_subscription_without_id_gets_one(http: httpx.Client) -> None:
    anonymous = wish("x")
    del anonymous["id"]
    answer = http.post("/subscriptions", json=anonymous)
    assert answer.status_code == 201
    assert http.get(answer.headers["location"].removeprefix("/ngsi-ld/v1")).status_code == 200


def test_an_id_that_is_taken_is_refused(http: httpx.Client) -> None:
    made(http, "twice")
    answer = http.post("/subscriptions", json=wish("twice"))
    assert answer.status_code == 409
    assert answer.json()["type"].endswith("AlreadyExists")


def test_before_the_first_attempt_a_subscription_holds_what_was_given_and_its_status(
    http: httpx.Client,
) -> None:
    shown = http.get(made(http, "plain")).json()
    assert shown["status"] == "active"
    assert shown.keys().isdisjoint({"isActive", "notificationTrigger"})
    assert shown["notification"] == {"endpoint": ENDPOINT}


@pytest.mark.parametrize("part", [{"attributes": ["b"]}, {"format": "concise"}, {"endpoint": None}, {}])
def test_a_change_with_an_incomplete_notification_is_refused(
    http: httpx.Client, part: dict[str, Any]
) -> None:
    name = f"incomplete-{'-'.join(part) or None}"
    path = made(http, name, notification={"endpoint": ENDPOINT, "attributes": ["a"]})
    before = http.get(path).json()
    answer = http.patch(path, json={"notification": part})
    assert answer.status_code == 400
    assert answer.json()["type"].endswith("BadRequestData")
    assert "endpoint" in answer.json()["detail"]
    assert http.get(path).json() == before


def test_a_change_replaces_members_and_null_deletes(http: httpx.Client) -> None:
    path = made(http, "change", q="n>1", notification={"endpoint": ENDPOINT, "attributes": ["a"]})
    notification = {"endpoint": ENDPOINT, "format": "concise"}
    change = {"q": None, "isActive": False, "notification": notification}
    assert http.patch(path, json=change).status_code == 204
    kept = http.get(path, params={"options": "sysAttrs"}).json()
    assert "q" not in kept
    assert kept["status"] == "paused"
    assert kept["modifiedAt"] > kept["createdAt"]
    assert kept["notification"]["format"] == "concise"
    assert kept["notification"]["endpoint"] == ENDPOINT
    assert "attributes" not in kept["notification"]


def test_a_change_that_cannot_be_leaves_everything_as_it_was(http: httpx.Client) -> None:
    path = made(http, "stubborn")
    assert http.patch(path, json={"q": "((", "isActive": False}).status_code == 400
    assert http.get(path).json()["status"] == "active"


def test_an_expired_subscription_has_that_status(http: httpx.Client, eventually: Any) -> None:
    soon = datetime.now(UTC) + timedelta(seconds=1)
    path = made(http, "expired", expiresAt=soon.strftime("%Y-%m-%dT%H:%M:%S.%fZ"))
    eventually(lambda: http.get(path).json()["status"] == "expired")
    assert http.patch(path, json={"expiresAt": "2999-01-01T00:00:00Z"}).status_code == 204
    assert http.get(path).json()["status"] == "active"


def test_a_deleted_subscription_is_not_found(http: httpx.Client) -> None:
    path = made(http, "gone")
    assert http.delete(path).status_code == 204
    for answer in (http.get(path), http.delete(path), http.patch(path, json={"isActive": True})):
        assert answer.status_code == 404
        assert answer.json()["type"].endswith("ResourceNotFound")


def test_subscriptions_are_listed_page_by_page(http: httpx.Client) -> None:
    for number in range(5):
        made(http, f"list-{number}")
    total = int(
        http.get("/subscriptions", params={"limit": 0, "count": "true"}).headers["ngsild-results-count"]
    )
    seen: list[str] = []
    for offset in range(0, total, 2):
        page = http.get("/subscriptions", params={"limit": 2, "offset": offset})
        seen += [one["id"] for one in page.json()]
        assert ('rel="next"' in page.headers["link"]) is (offset + 2 < total)
    assert len(set(seen)) == len(seen) == total >= 5


@pytest.mark.parametrize(
    ("members", "status", "word"),
    [
        ({"entities": None}, 400, "watchedAttributes"),
        ({"entities": []}, 400, "selector"),
        ({"entities": [{}]}, 400, "selector"),
        ({"entities": [{"kind": "Task"}]}, 400, "kind"),
        ({"entities": [{"type": "Task", "id": "x y"}]}, 400, "URI"),
        ({"entities": [{"type": "Task", "idPattern": "("}]}, 400, "pattern"),
        ({"entities": [{"type": 4}]}, 400, "4"),
        ({"type": "Order"}, 400, "Order"),
        ({"colour": "red"}, 400, "colour"),
        ({"q": "status=="}, 400, "character"),
        ({"q": 4}, 400, "text"),
        ({"watchedAttributes": []}, 400, "watchedAttributes"),
        ({"watchedAttributes": [3]}, 400, "watchedAttributes"),
        ({"throttling": -1}, 400, "throttling"),
        ({"throttling": True}, 400, "throttling"),
        ({"expiresAt": "tomorrow"}, 400, "expiresAt"),
        ({"expiresAt": "2020-01-01T00:00:00Z"}, 400, "is over"),
        ({"notificationTrigger": []}, 400, "notificationTrigger"),
        ({"notificationTrigger": ["entityMoved"]}, 400, "entityMoved"),
        ({"timeInterval": 5, "throttling": 2}, 400, "throttling"),
        ({"timeInterval": 5, "watchedAttributes": ["a"]}, 400, "watchedAttributes"),
        ({"timeInterval": 5, "notificationTrigger": ["entityDeleted"]}, 400, "notificationTrigger"),
        ({"timeInterval": 0.1}, 400, "timeInterval"),
        ({"scopeQ": 4}, 400, "scopeQ"),
        ({"csf": 4}, 400, "csf"),
        ({"csf": "(("}, 400, "csf"),
        ({"splitEntities": "yes"}, 400, "splitEntities"),
        ({"ngsildConformance": "new"}, 400, "ngsildConformance"),
        ({"expandValues": 4}, 400, "expandValues"),
        ({"localOnly": "yes"}, 400, "localOnly"),
        ({"lang": 4}, 400, "lang"),
        ({"datasetId": ["no uri"]}, 400, "URI"),
        ({"temporalQ": {}}, 400, "context sources"),
        ({"entities": [{"type": "A;("}]}, 400, "A;("),
        ({"isActive": "yes"}, 400, "isActive"),
        ({"id": "no uri"}, 400, "URI"),
        ({"notification": None}, 400, "endpoint"),
        ({"notification": {"endpoint": {}}}, 400, "uri"),
        ({"notification": {"endpoint": {"uri": "ftp://a.example/x"}}}, 400, "http"),
        ({"notification": {"endpoint": {"uri": "http://:80/x"}}}, 400, "http"),
        ({"notification": {"endpoint": {"uri": "http://a.example:99999/"}}}, 400, "http"),
        ({"notification": {"endpoint": {"uri": "http://169.254.169.254/latest"}}}, 400, "OUTBOUND_ALLOW"),
        ({"notification": {"endpoint": {"uri": "mqtt://169.254.169.254/topic"}}}, 400, "OUTBOUND_ALLOW"),
        ({"notification": {"endpoint": {"uri": "mqtt://a.example"}}}, 400, "topic"),
        ({"notification": {"endpoint": {"uri": "mqtt://a.example/cell/#"}}}, 400, "reading"),
        ({"notification": {"endpoint": mqtt("MQTT-QoS", "3")}}, 400, "MQTT-QoS"),
        ({"notification": {"endpoint": mqtt("MQTT-Version", "4")}}, 400, "mqtt3.1.1"),
        ({"notification": {"endpoint": {**ENDPOINT, "colour": "red"}}}, 400, "colour"),
        ({"notification": {"endpoint": {**ENDPOINT, "cooldown": -1}}}, 400, "cooldown"),
        ({"notification": {"endpoint": ENDPOINT, "colour": "red"}}, 400, "colour"),
        ({"notification": {"endpoint": ENDPOINT, "pick": "a"}}, 400, "pick"),
        ({"notification": {"endpoint": ENDPOINT, "pick": ["a"], "attributes": ["a"]}}, 400, "pick"),
        ({"notification": {"endpoint": ENDPOINT, "showChanges": "yes"}}, 400, "showChanges"),
        ({"notification": {"endpoint": ENDPOINT, "showChanges": True, "format": "keyValues"}}, 400, "format"),
        ({"notification": {"endpoint": ENDPOINT, "join": "up"}}, 400, "join"),
        ({"notification": {"endpoint": ENDPOINT, "joinLevel": 2}}, 400, "joinLevel"),
        ({"notification": {"endpoint": ENDPOINT, "join": "flat", "joinLevel": 0}}, 400, "joinLevel"),
        (
            {"notification": {"endpoint": {**ENDPOINT, "receiverInfo": [{"key": "Host", "value": "x"}]}}},
            400,
            "Host",
        ),
        ({"notification": {"endpoint": {**ENDPOINT, "accept": "text/html"}}}, 400, "accept"),
        ({"notification": {"endpoint": ENDPOINT, "format": "xml"}}, 400, "format"),
        ({"notification": {"endpoint": ENDPOINT, "attributes": "a"}}, 400, "attributes"),
        ({"notification": {"endpoint": {**ENDPOINT, "timeout": "x"}}}, 400, "timeout"),
        (
            {"notification": {"endpoint": {**ENDPOINT, "receiverInfo": [{"key": "X\r\nY", "value": "1"}]}}},
            400,
            "header",
        ),
        (
            {
                "notification": {
                    "endpoint": {**ENDPOINT, "receiverInfo": [{"key": "X", "value": "1\r\nY: 2"}]}
                }
            },
            400,
            "header",
        ),
        ({"geoQ": {}}, 400, "geoQ"),
    ],
)
def test_an_invalid_subscription_is_refused_with_the_reason(
    http: httpx.Client, members: dict[str, Any], status: int, word: str
) -> None:
    body = {name: value for name, value in wish("refused", **members).items() if value is not None}
    answer = http.post("/subscriptions", json=body)
    assert answer.status_code == status, answer.text
    assert word in answer.json()["detail"]
    assert http.get(f"/subscriptions/{wish('refused')['id']}").status_code == 404
