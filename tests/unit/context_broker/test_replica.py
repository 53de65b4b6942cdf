"""Several brokers on one database: what overtakes a write, and which places are given."""

from itertools import islice

from hypothesis import given
from hypothesis import strategies as st

from services.context_broker.storage.entries import EntityRow, Entries, Kind
from services.context_broker.storage.places import SLOTS, Places
from services.context_broker.storage.replica import News, Unknown
from services.context_broker.temporal.archive import DepartedRow

ENTITY = Entries(entities={7: EntityRow("", "urn:e:1", b"[]")})


def overtaken(news: News, entries: Entries, known: int = 4) -> bool:
    unknown = Unknown()
    unknown.note(news)
    return unknown.overtakes(entries, known)


def news(number: int = 5, **what: object) -> News:
    return News(number, "another", **what)  # type: ignore[arg-type]  # each test says which


def test_a_change_of_the_same_entity_overtakes_and_that_of_another_does_not() -> None:
    assert overtaken(news(entities={7: ("", "urn:e:1", b"[]")}), ENTITY)
    assert overtaken(news(entities={9: ("", "urn:e:1", b"[]")}), ENTITY), "made anew at another place"
    assert not overtaken(news(entities={8: ("", "urn:e:2", b"[]")}), ENTITY)
    assert not overtaken(news(entities={8: ("other", "urn:e:1", b"[]")}), ENTITY)


def test_what_was_known_when_a_write_was_made_does_not_overtake_it() -> None:
    assert not overtaken(news(entities={7: ("", "urn:e:1", b"[]")}), ENTITY, known=5)
    assert overtaken(news(6, entities={7: ("", "urn:e:1", b"[]")}), ENTITY, known=5)


def test_two_entities_at_one_place_do_not_pass() -> None:
    assert overtaken(news(entities={7: ("other", "urn:e:2", b"[]")}), ENTITY)
    gone = Entries(departed={7: DepartedRow("", "urn:e:3", b"[]")})
    assert overtaken(news(departed={7: ("", "urn:e:4")}), gone)
    assert overtaken(news(departed={8: ("", "urn:e:3")}), gone)


def test_a_new_subscription_overtakes_all_changes_of_its_tenant() -> None:
    key = (Kind.SUBSCRIPTION, "", "urn:s")
    assert overtaken(news(documents={key: b"{}"}), ENTITY)
    assert not overtaken(news(documents={(Kind.SUBSCRIPTION, "other", "urn:s"): b"{}"}), ENTITY)


def test_counts_overtake_nothing_and_are_not_overtaken() -> None:
    counts = {(Kind.COUNTS, "", "urn:s"): b"[]"}
    assert not overtaken(news(documents=dict(counts)), Entries(documents=dict(counts)))


def test_registrations_are_weighed_against_all_others_of_the_tenant() -> None:
    mine = Entries(documents={(Kind.REGISTRATION, "", "urn:r:1"): b"{}"})
    assert overtaken(news(documents={(Kind.REGISTRATION, "", "urn:r:2"): b"{}"}), mine)
    assert not overtaken(news(documents={(Kind.REGISTRATION, "other", "urn:r:2"): b"{}"}), mine)


def test_what_was_loaded_anew_overtakes_everything_that_was_made_before() -> None:
    assert overtaken(news(is_everything=True), Entries(settled=[1]))
    assert not overtaken(news(is_everything=True), Entries(settled=[1]), known=5)


def test_what_the_loop_knows_is_forgotten() -> None:
    unknown = Unknown()
    unknown.note(news(5, entities={7: ("", "urn:e:1", b"[]")}))
    unknown.note(news(6, entities={8: ("", "urn:e:2", b"[]")}))
    unknown.forget(5)
    assert not unknown.overtakes(ENTITY, 4)
    assert unknown.overtakes(Entries(entities={8: EntityRow("", "urn:e:2", None)}), 5)


def test_a_broker_of_its_own_counts() -> None:
    assert list(islice(Places(41), 3)) == [42, 43, 44]


@given(
    last=st.integers(0, 10**12),
    slots=st.lists(st.integers(0, SLOTS - 1), min_size=2, max_size=4, unique=True),
    turns=st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=60),
)
def test_places_never_meet_and_are_after_all_that_was_seen(
    last: int, slots: list[int], turns: list[tuple[int, bool]]
) -> None:
    brokers = [Places(last, slot) for slot in slots]
    seen = dict.fromkeys(brokers, last)
    given_out: set[int] = set()
    for turn, tells in turns:
        broker = brokers[turn % len(brokers)]
        place = next(broker)
        assert place not in given_out
        assert place > seen[broker]
        assert broker.may_be_mine(place)
        given_out.add(place)
        for other in brokers if tells else [broker]:
            other.seen(place)
            seen[other] = max(seen[other], place)
