"""History: recorded changes are returned, for any query."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model import changes
from handover_broker.model.entity import Instance
from handover_broker.model.entity_parser import read_change, read_entity
from handover_broker.model.validation import MICROS, timestamp
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.journal import Journal
from handover_broker.temporal import history_reader
from handover_broker.temporal.aggregation import Aggregation
from handover_broker.temporal.durations import read_duration
from handover_broker.temporal.history import (
    HistoryRecorder,
    RowContent,
    change_of,
    instance_id,
    micros_of,
    parse_instance_id,
    time_of,
)
from handover_broker.temporal.history_reader import (
    EvolutionPage,
    HistoryRequest,
    read_evolution,
    read_evolutions,
)
from handover_broker.temporal.query import TemporalQuery
from handover_broker.temporal.rendering import content_range
from handover_broker.temporal.subjects import subjects_of

from .recorded_entities import PLACES, START, TERMS, RecordedEntity, event

NAMES = ("speed", "heading", "place")


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Journal]:
    made = Journal(SqliteDatabase(tmp_path_factory.mktemp("history") / "broker.db"))
    made.open()
    yield made
    made.close()


def without_id(instance: Instance) -> Instance:
    return {member: value for member, value in instance.items() if member != "instanceId"}


def points_of(found: EvolutionPage) -> list[tuple[str, int, Instance]]:
    (evolution,) = found.evolutions
    return [
        (name, at, one)
        for name, named in evolution.series.items()
        for series in named.values()
        for at, _, one in series.points
    ]


VALUES = st.integers(-5, 5) | st.sampled_from(["a", "b"]) | st.lists(st.integers(0, 3), max_size=2)
INSTANCES = st.fixed_dictionaries(
    {"type": st.just("Property"), "value": VALUES},
    optional={
        "observedAt": st.integers(0, 20).map(lambda s: timestamp(START + timedelta(minutes=s))),
        "datasetId": st.sampled_from(["urn:d:1", "urn:d:2"]),
    },
)
ATTRIBUTES = st.lists(INSTANCES, min_size=1, max_size=3, unique_by=lambda one: str(one.get("datasetId")))
DOCUMENTS = st.dictionaries(st.sampled_from(NAMES), ATTRIBUTES, max_size=3)
STEPS = st.lists(
    st.tuples(st.sampled_from(["appended", "updated", "replaced", "merged"]), DOCUMENTS), max_size=8
)


def lived(journal: Journal, first: dict[str, Any], steps: list[tuple[str, dict[str, Any]]]) -> RecordedEntity:
    life = RecordedEntity(journal)
    life.create(first)
    for how, document in steps:
        life.change(document, how)
    return life


@given(DOCUMENTS, STEPS)
def test_recorded_changes_are_returned(
    journal: Journal, first: dict[str, Any], steps: list[tuple[str, dict[str, Any]]]
) -> None:
    life = lived(journal, first, steps)
    returned = [
        (name, without_id(one))
        for name, _, one in points_of(life.read(TemporalQuery(time_property="modifiedAt")))
    ]
    assert sorted(returned, key=repr) == sorted(life.written, key=repr)
    everything = [(name, without_id(one)) for name, _, one in points_of(life.read(TemporalQuery()))]
    assert sorted(everything, key=repr) == sorted(life.written, key=repr)
    gone = [
        (name, one.get("datasetId"), one["deletedAt"])
        for name, _, one in points_of(life.read(TemporalQuery(time_property="deletedAt")))
    ]
    assert sorted(gone, key=repr) == sorted(life.deleted, key=repr)


@given(
    st.tuples(DOCUMENTS, STEPS),
    st.sampled_from(["observedAt", "createdAt", "modifiedAt"]),
    st.sampled_from(["before", "after", "between"]),
    st.tuples(st.integers(-1, 21), st.integers(1, 10), st.sampled_from([1, 60])),
)
def test_a_range_returns_exactly_its_instances(
    journal: Journal,
    end: tuple[dict[str, Any], list[tuple[str, dict[str, Any]]]],
    name: str,
    relation: str,
    window: tuple[int, int, int],
) -> None:
    at, length, unit_s = window
    life = lived(journal, *end)
    low = micros_of(timestamp(START + timedelta(seconds=at * unit_s)))
    high = low + length * unit_s * MICROS
    query = {
        "before": TemporalQuery(relation, None, low, name),
        "after": TemporalQuery(relation, low, None, name),
        "between": TemporalQuery(relation, low, high, name),
    }[relation]

    def is_in(instance: Instance) -> bool:
        if name not in instance:
            return False
        time = micros_of(instance[name])
        return {"before": time < low, "after": time >= low, "between": low <= time < high}[relation]

    expected = [(attribute, one) for attribute, one in life.written if is_in(one)]
    returned = [(attribute, without_id(one)) for attribute, _, one in points_of(life.read(query))]
    assert sorted(returned, key=repr) == sorted(expected, key=repr)


@given(DOCUMENTS, STEPS, st.integers(1, 4))
def test_the_last_instances_are_the_latest_of_each_series(
    journal: Journal, first: dict[str, Any], steps: list[tuple[str, dict[str, Any]]], last: int
) -> None:
    life = lived(journal, first, steps)
    everything = TemporalQuery(time_property="modifiedAt")
    (whole,) = life.read(everything).evolutions
    (some,) = life.read(replace(everything, last=last)).evolutions
    for name, named in whole.series.items():
        for dataset, series in named.items():
            assert some.series[name][dataset].points == series.points[-last:]


@given(st.lists(st.integers(0, 30), min_size=1, max_size=40), st.integers(1, 5), st.booleans())
def test_continuing_at_the_edge_repeats_only_the_last_instant(
    journal: Journal, minutes: list[int], most: int, latest: bool
) -> None:
    life = RecordedEntity(journal)
    life.create({})
    for number, minute in enumerate(minutes):
        seen = timestamp(START + timedelta(minutes=minute))
        attribute = NAMES[number % 2]
        life.change({attribute: {"type": "Property", "value": number, "observedAt": seen}})
    query = TemporalQuery(
        "after", micros_of(timestamp(START)) - 1, None, "observedAt", 10_000 if latest else None
    )
    found: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history_reader, "MAX_INSTANCES_PER_ATTRIBUTE", most)
        for _ in range(2 * len(minutes) + 1):
            returned = life.read(query)
            found += [one["value"] for _, _, one in points_of(returned)]
            said = content_range(returned, query)
            if returned.edge is None:
                assert said is None
                break
            assert said is not None
            start, _, end = said.decode().removeprefix("date-time ").rpartition("/")[0].partition("Z-")
            assert latest or f"{start}Z" != end, "the next request would be the same"
            query = replace(query, end=returned.edge) if latest else replace(query, start=micros_of(end))
    assert sorted(set(found)) == list(range(len(minutes)))
    again = {minutes[number] for number in found if found.count(number) > 1}
    assert all(found.count(number) <= 2 for number in found)
    assert not latest or not again


@given(
    st.lists(st.integers(0, 600), min_size=1, max_size=40),
    st.integers(1, 4),
    st.sampled_from(["PT7M", "PT1H"]),
)
def test_aggregations_continue_at_the_edge(
    journal: Journal, minutes: list[int], most: int, period: str
) -> None:
    life = RecordedEntity(journal)
    life.create({})
    for number, minute in enumerate(minutes):
        seen = timestamp(START + timedelta(minutes=minute))
        life.change({NAMES[number % 2]: {"type": "Property", "value": 1, "observedAt": seen}})
    wanted = Aggregation(("totalCount",), read_duration(period, "d"))
    query = TemporalQuery("after", micros_of(timestamp(START)) - 1, None, "observedAt", None, wanted)
    counted = 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history_reader, "MAX_INSTANCES_PER_ATTRIBUTE", most)
        for _ in range(2 * len(minutes) + 1):
            found = life.read(query)
            series = [one for evolution in found.evolutions for one in evolution.all()]
            assert all(len(one.totals) <= most for one in series)
            counted += sum(total.values["totalCount"] for one in series for total in one.totals)
            said = content_range(found, query)
            if said is None:
                break
            end = said.decode().removesuffix("/*").rpartition("Z-")[2]
            query = replace(query, start=micros_of(end))
    assert counted == len(minutes)


def test_instances_of_one_time_are_ordered_by_write(journal: Journal) -> None:
    life = RecordedEntity(journal)
    life.create({})
    for number in range(5):
        life.change({"speed": {"type": "Property", "value": number, "observedAt": timestamp(START)}})
    returned = life.read(TemporalQuery(time_property="observedAt", last=2))
    assert [one["value"] for _, _, one in points_of(returned)] == [3, 4]


def test_too_many_values_to_aggregate_are_refused_with_a_remedy(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history_reader, "MAX_AGGREGATED_VALUES", 3)
    life = RecordedEntity(journal)
    life.create({})
    for number in range(9):
        seen = timestamp(START + timedelta(minutes=number))
        life.change({"speed": {"type": "Property", "value": number, "observedAt": seen}})
    wanted = Aggregation(("sum",), read_duration("PT0S", "d"))
    with pytest.raises(Problem, match="shorter time") as refused:
        life.read(TemporalQuery(time_property="observedAt", aggregation=wanted))
    assert refused.value.status == 403
    (latest,) = life.read(TemporalQuery(time_property="observedAt", last=2, aggregation=wanted)).evolutions
    assert [total.values for series in latest.all() for total in series.totals] == [{"sum": 15}]


def test_a_partial_response_ends_at_one_time_for_all_entities(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history_reader, "MAX_INSTANCES_PER_ANSWER", 10)
    lives = [RecordedEntity(journal) for _ in range(3)]
    for life in lives:
        life.create({})
    for minute in range(10):
        for life in lives:
            seen = timestamp(START + timedelta(minutes=minute))
            life.change({"speed": {"type": "Property", "value": minute, "observedAt": seen}})
    question = HistoryRequest(TemporalQuery(time_property="observedAt"), lambda _: True)
    found = read_evolutions(journal.archive, [life.subject() for life in lives], question, 0, 10, count=True)
    assert found.total == 3
    assert found.edge is not None
    counts = [sum(len(series.points) for series in one.all()) for one in found.evolutions]
    assert counts == [4, 4, 4]  # the tenth and those of its instant: instances of one time stay together


def test_pages_of_entities_hold_each_once(journal: Journal) -> None:
    lives = [RecordedEntity(journal) for _ in range(7)]
    for number, life in enumerate(lives):
        life.create({"speed": number} if number % 2 else {"heading": number})
    subjects = [life.subject() for life in lives]
    question = HistoryRequest(TemporalQuery(), lambda _: True, requires=frozenset({TERMS.expand("speed")}))
    pages = [
        read_evolutions(journal.archive, subjects, question, offset, 2, count=False) for offset in (0, 2)
    ]
    assert [one.subject.id for page in pages for one in page.evolutions] == [
        f"urn:x:{life.place}" for life in lives[1::2]
    ]
    assert [page.more for page in pages] == [True, False]


def test_a_recreated_entity_has_one_history(journal: Journal) -> None:
    life = RecordedEntity(journal)
    life.create({"speed": 1})
    assert life.entity is not None
    entity_id, first = life.entity.id, life.place
    life.take(None, life.step())
    assert life.subject().deleted_at is not None
    life.place = next(PLACES)
    at = life.step()
    again = read_entity({"id": entity_id, "type": "Car", "speed": 2}, TERMS)
    life.take(changes.created(again, at, life.place), at)
    assert life.entity is not None
    life.commit()
    (subject,) = subjects_of((life.entity,), journal.archive.temporal_only_entities("", entity_id))
    assert subject.entity_seqs == (first, life.place)
    assert subject.deleted_at is None
    found = read_evolution(
        journal.archive, subject, HistoryRequest(TemporalQuery(time_property="modifiedAt"), lambda _: True)
    )
    assert [one["value"] for _, _, one in points_of(found)] == [1, 2]


def test_a_change_of_the_same_value_is_a_change() -> None:
    before = changes.created(
        read_entity({"id": "urn:x:1", "type": "Car", "speed": 1}, TERMS), timestamp(START), 1
    )
    after = changes.appended(before, read_change({"speed": 1}, TERMS), timestamp(START + timedelta(1))).entity
    change = change_of(event(before, after))
    assert change is not None
    assert list(change.attributes) == [TERMS.expand("speed")]
    assert change_of(event(after, after)) is None


def test_a_change_without_a_new_time_has_its_own_row(journal: Journal) -> None:
    life = RecordedEntity(journal)
    life.create({"speed": 1})
    assert life.entity is not None
    life.take(replace(life.entity, scopes=("/a",)), life.entity.modified_at)
    life.commit()
    assert len(list(journal.archive.history([life.place]))) == 2


def test_changes_of_one_instant_keep_their_order() -> None:
    recorder = HistoryRecorder()
    at = timestamp(START)
    seqs = [recorder.row(1, RowContent(), at).seq for _ in range(5)]
    assert seqs == sorted(set(seqs))
    assert time_of(seqs[0]) == at


@given(st.integers(0, 2**60 - 1), st.integers(0, 2**60 - 1), st.integers(0, 10**6))
def test_an_instance_id_contains_its_position(place: int, seq: int, position: int) -> None:
    assert parse_instance_id(instance_id(place, seq, position)) == (place, seq, position)


@pytest.mark.parametrize(
    "text", ["", "urn:ngsi-ld:Instance:1-2", "urn:ngsi-ld:Instance:1-2-3x", "urn:x:1-2-3"]
)
def test_a_foreign_instance_id_is_not_found(text: str) -> None:
    assert parse_instance_id(text) is None
