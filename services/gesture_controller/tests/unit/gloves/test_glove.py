"""A glove answers a Task with the right gesture, held long enough, after it was asked, and once."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from handover.job import RequestedAction
from handover.security.proofs.pin_check import ProvenPin
from handover_datamodels.states import Outcome
from handover_gloves.gloves.gesture_responder import Station
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.glove_view import view_of
from handover_gloves.prompting.prompt import CannotComplete
from handover_gloves.recognition.frames import Hello

Ask = Callable[..., Any]


async def test_the_asked_gesture_held_1500_ms_answers_the_task(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    hand.show(None, 0.5)
    hand.show("Thumbs up", 1.48)
    assert not prompt.answer.done()
    hand.show("Thumbs up", 0.04)
    assert prompt.answer.result().outputs() == {
        "gesture": "Thumbs up",
        "commandId": 3,
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "ok",
    }
    assert glove.responder.command is not None
    assert glove.responder.command[0] == 3


async def test_the_asked_gesture_is_announced_at_500_ms(glove: Glove, hand: Any, ask: Ask) -> None:
    ask("Thumbs up")
    hand.show("Thumbs up", 0.4)
    assert view_of(glove, hand.now_s)["message"]["text"] == "Show: Thumbs up."
    hand.show("Thumbs up", 0.2)
    view = view_of(glove, hand.now_s)
    assert view["message"]["text"] == "Right. Hold it for another second to confirm."
    assert view["hold"] == {
        "gesture": "Thumbs up",
        "heldMs": 580,
        "announceMs": 500,
        "confirmMs": 1500,
        "spent": False,
        "outcome": "ok",
    }


async def test_a_wrong_gesture_never_answers_and_the_message_names_the_finger(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    prompt = ask("Thumbs up")
    hand.show("Thumb and little straight", 5)
    view = view_of(glove, hand.now_s)
    assert not prompt.answer.done()
    assert view["differs"] == ["little"]
    assert view["message"]["text"] == (
        "That is Thumb and little straight, not the requested gesture: bend your little finger."
    )
    assert glove.responder.command is None


async def test_a_hand_that_is_nearly_right_is_helped(glove: Glove, hand: Any, ask: Ask) -> None:
    ask("Thumbs up")
    hand.make("02212", 0.3)
    assert view_of(glove, hand.now_s)["message"]["text"] == "Show: Thumbs up."
    hand.make("02212", 0.3)
    assert view_of(glove, hand.now_s)["message"]["text"] == "Show: Thumbs up. Almost: bend your ring finger."


async def test_a_hold_that_began_before_the_task_does_not_count(glove: Glove, hand: Any, ask: Ask) -> None:
    hand.show("Thumbs up", 10)
    prompt = ask("Thumbs up")
    hand.show("Thumbs up", 1.4)
    assert not prompt.answer.done()
    hand.show("Thumbs up", 0.2)
    assert prompt.answer.done()


async def test_one_hold_answers_one_task(glove: Glove, hand: Any, ask: Ask) -> None:
    first = ask("Thumbs up")
    hand.show("Thumbs up", 2)
    assert first.answer.done()
    glove.responder.end()
    second = ask("Thumbs up", "t2")
    hand.show("Thumbs up", 5)
    assert not second.answer.done()
    view = view_of(glove, hand.now_s)
    assert view["message"]["text"] == "Already counted. Let go, then show Thumbs up again."
    assert view["hold"]["heldMs"] == 0
    hand.show(None, 0.3)
    hand.show("Thumbs up", 1.6)
    assert second.answer.done()


async def test_in_testing_mode_nothing_answers_but_all_is_shown(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    glove.switch(testing=True, filtering=False)
    hand.show("Thumbs up", 5)
    view = view_of(glove, hand.now_s)
    assert not prompt.answer.done()
    assert glove.responder.command is None
    assert (view["states"], view["gesture"], view["testing"]) == ("02222", "Thumbs up", True)
    assert view["bend"] == [700.0, 300.0, 300.0, 300.0, 300.0]
    assert view["message"]["text"] == "Test mode: nothing is sent. This is Thumbs up."
    with pytest.raises(CannotComplete, match="switch testing off, then complete"):
        glove.responder.complete_on_screen("Anna", hand.now_s)
    glove.switch(testing=False, filtering=None)
    hand.show("Thumbs up", 1.4)
    assert not prompt.answer.done()
    hand.show("Thumbs up", 0.2)
    assert prompt.answer.done()


async def test_without_filtering_every_gesture_with_a_command_is_given_once(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    glove.switch(testing=None, filtering=False)
    hand.show("Horns", 3)
    assert glove.responder.command is not None
    assert glove.responder.command[0] == 8
    given_at = glove.responder.command[1]
    hand.show("Horns", 3)
    assert glove.responder.command == (8, given_at)
    prompt = ask("Thumbs up")
    hand.show("Little straight", 3)
    assert glove.responder.command[0] == 7
    assert not prompt.answer.done()
    hand.show("Thumbs up", 1.6)
    assert prompt.answer.done()


async def test_with_filtering_no_gesture_gives_a_command_without_a_task(glove: Glove, hand: Any) -> None:
    hand.show("Horns", 5)
    assert glove.responder.command is None


async def test_while_paused_on_the_screen_nothing_answers(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    glove.pause()
    assert prompt.job.requested_action is RequestedAction.PAUSE
    assert glove.device_state == "paused"
    hand.show("Thumbs up", 5)
    assert not prompt.answer.done()
    with pytest.raises(CannotComplete, match="is paused; resume it"):
        glove.responder.complete_on_screen("Anna", hand.now_s)
    glove.resume()
    assert prompt.job.requested_action is RequestedAction.RUN
    hand.show("Thumbs up", 1.4)
    assert not prompt.answer.done()
    hand.show("Thumbs up", 0.2)
    assert prompt.answer.done()


async def test_a_task_that_comes_while_paused_on_the_screen_waits(glove: Glove, hand: Any, ask: Ask) -> None:
    glove.pause()
    prompt = ask("Thumbs up")
    assert prompt.job.requested_action is RequestedAction.PAUSE
    assert "Paused on the screen" in view_of(glove, hand.now_s)["message"]["text"]


async def test_a_glove_silent_for_2_s_in_a_task_holds_it_until_it_is_back(
    glove: Glove, hand: Any, ask: Ask, listener_log: Any
) -> None:
    prompt = ask("Thumbs up")
    hand.show(None, 0.2)
    hand.be_silent(1.9)
    assert prompt.job.requested_action is RequestedAction.RUN
    hand.be_silent(0.2)
    assert prompt.job.requested_action is RequestedAction.PAUSE
    assert listener_log.silent == ["glove-1"]
    assert glove.device_state == "error"
    assert "No data from glove-1" in view_of(glove, hand.now_s)["message"]["text"]
    assert view_of(glove, hand.now_s)["connected"] is False
    hand.be_silent(60)
    assert listener_log.silent == ["glove-1"]
    glove.responder.stop_listening()  # as the controller does while the Task is paused
    hand.show("Thumbs up", 0.02)
    assert prompt.job.requested_action is RequestedAction.RUN
    assert glove.device_state == "busy"
    hand.show("Thumbs up", 1.6)
    assert prompt.answer.done()
    assert listener_log.back == ["glove-1", "glove-1"]  # its first frame ever, and its return


async def test_a_silent_gloves_task_can_be_completed_on_the_screen(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    hand.be_silent(3)
    glove.responder.complete_on_screen("Anna", hand.now_s)
    assert prompt.job.requested_action is RequestedAction.RUN
    assert prompt.answer.result().outputs() == {
        "gesture": "Thumbs up",
        "commandId": 3,
        "heldMs": 0,
        "by": "screen",
        "operator": "Anna",
        "outcome": "ok",
    }


async def test_the_answer_names_the_person_at_the_station_and_never_one_of_the_client(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    held: list[str] = []
    glove.responder.station = Station(lambda: "urn:ngsi-ld:Person:demo:anna", held.append)
    hand.show("Horns", 1.6)
    assert held == ["Horns"], "without a Task a gesture identifies a person"
    hand.show(None, 0.5)
    prompt = ask("Thumbs up")
    hand.show("Thumbs up", 1.6)
    assert prompt.answer.result().outputs()["performedBy"] == "urn:ngsi-ld:Person:demo:anna"
    assert held == ["Horns"], "the answer to a Task identifies nobody"
    glove.responder.end()
    prompt = ask("Thumbs up")
    ben = "urn:ngsi-ld:Person:demo:ben"
    glove.responder.complete_on_screen("Ben", hand.now_s, performed_by=ben)
    assert prompt.answer.result().outputs()["performedBy"] == ben, "who is signed in at the screen"


async def test_a_pause_on_the_screen_outlives_the_return_of_the_glove(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    prompt = ask("Thumbs up")
    hand.be_silent(3)
    glove.pause()
    hand.show(None, 0.1)
    assert prompt.job.requested_action is RequestedAction.PAUSE


async def test_a_task_without_a_glove_asks_to_put_it_on_and_is_not_held(
    glove: Glove, ask: Ask, listener_log: Any
) -> None:
    prompt = ask("Thumbs up")
    glove.check_silence(60.0, silence_s=2.0)
    assert prompt.job.requested_action is RequestedAction.RUN
    assert listener_log.silent == []
    assert view_of(glove, 60.0)["message"]["text"].startswith("Put on glove-1")
    glove.responder.complete_on_screen("Anna", 60.0)
    assert prompt.answer.result().by == "screen"


async def test_nothing_can_be_completed_without_a_task(glove: Glove) -> None:
    with pytest.raises(CannotComplete, match="has no Task"):
        glove.responder.complete_on_screen("Anna", 1.0)


async def test_a_task_is_completed_on_the_screen_only_once(glove: Glove, hand: Any, ask: Ask) -> None:
    ask("Thumbs up")
    glove.responder.complete_on_screen("Anna", hand.now_s)
    with pytest.raises(CannotComplete, match="has no Task"):
        glove.responder.complete_on_screen("Ben", hand.now_s)


async def test_a_press_that_was_meant_for_another_task_answers_none(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    prompt = ask("Thumbs up", "t2")
    with pytest.raises(CannotComplete, match="no longer for urn:ngsi-ld:Task:demo:t1"):
        glove.responder.complete_on_screen("Anna", hand.now_s, "urn:ngsi-ld:Task:demo:t1")
    assert not prompt.answer.done()
    glove.responder.complete_on_screen("Anna", hand.now_s, prompt.spec.task_id)
    assert prompt.answer.result().by == "screen"


async def test_a_new_connection_takes_the_place_of_a_silent_one(glove: Glove, hand: Any) -> None:
    newer = type(hand.wire)()
    glove.connect(newer, Hello("glove-1", "left"), hand.now_s + 3)
    assert hand.wire.ended == ["glove-1 has connected again, since this connection was silent"]
    glove.disconnect(hand.wire)
    assert glove.connection.link is newer
    assert glove.hand == "left"
    glove.disconnect(newer)
    assert not glove.is_connected


async def test_a_hold_does_not_go_on_over_a_new_connection(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    hand.show("Thumbs up", 1.4)
    glove.disconnect(hand.wire)
    glove.connect(type(hand.wire)(), Hello("glove-1"), hand.now_s)
    hand.show("Thumbs up", 1.4)
    assert not prompt.answer.done()


async def test_other_thresholds_read_the_hand_at_once(glove: Glove, hand: Any) -> None:
    hand.make("02222", 0.1)
    glove.configure(
        replace(
            glove.reader.config,
            thresholds=glove.reader.config.thresholds.with_changes({"thumb": {"upper": 800}}),
        )
    )
    hand.make("02222", 0.1)
    assert glove.reader.state.states == "12222"


async def test_the_device_state_follows_the_work(
    glove: Glove, hand: Any, ask: Ask, listener_log: Any
) -> None:
    hand.show(None, 0.1)
    ask("Thumbs up")
    glove.pause()
    glove.resume()
    hand.show("Thumbs up", 1.6)
    glove.responder.end()
    glove.disconnect(hand.wire)
    assert listener_log.states == ["ok", "busy", "paused", "busy", "ok", "idle"]


async def test_the_rate_is_measured(glove: Glove, hand: Any) -> None:
    hand.show(None, 3.0, hz=50)
    assert view_of(glove, hand.now_s)["rate_hz"] == pytest.approx(50, abs=1)
    hand.be_silent(3)
    assert view_of(glove, hand.now_s)["rate_hz"] == 0


async def test_thanks_are_said_for_a_while(glove: Glove, hand: Any, ask: Ask) -> None:
    ask("Thumbs up")
    hand.show("Thumbs up", 1.6)
    glove.responder.end()
    assert view_of(glove, hand.now_s)["message"]["text"] == "Confirmed: Thumbs up."
    assert view_of(glove, hand.now_s + 6)["message"]["text"] == "No task for you."


async def test_the_last_answer_stays_in_view_when_the_next_task_is_there_at_once(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    assert view_of(glove, hand.now_s)["answered"] is None
    first = ask("Thumbs up")
    hand.show("Thumbs up", 1.6)
    glove.responder.end()
    ask("Horns", "t2")
    hand.show("Thumbs up", 0.1)
    view = view_of(glove, hand.now_s)
    assert view["message"]["key"] == "show"
    assert view["answered"] == {
        "task": first.spec.task_id,
        "gesture": "Thumbs up",
        "by": "gesture",
        "operator": None,
        "outcome": "ok",
        "note": None,
    }
    assert view["hold"]["spent"] is True
    glove.responder.complete_on_screen("Anna", hand.now_s)
    assert view_of(glove, hand.now_s)["answered"]["operator"] == "Anna"


async def test_a_lost_glove_is_seen_to_be_lost(glove: Glove, hand: Any, ask: Ask) -> None:
    ask("Thumbs up")
    hand.show(None, 0.2)
    assert view_of(glove, hand.now_s)["lost"] is False
    hand.be_silent(2.2)
    assert view_of(glove, hand.now_s)["lost"] is True


async def test_an_answer_gesture_answers_with_its_outcome_and_gives_no_command(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    prompt = ask("Thumbs up", answers={Outcome.NOT_GOOD: "Horns", Outcome.PROBLEM: "Ring straight"})
    hand.show("Horns", 0.6)
    view = view_of(glove, hand.now_s)
    assert view["message"]["key"] == "holdOnNotGood"
    assert (view["hold"]["gesture"], view["hold"]["outcome"]) == ("Horns", "notGood")
    assert not prompt.answer.done()
    hand.show("Horns", 1.0)
    assert prompt.answer.result().outputs() == {
        "gesture": "Horns",
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "notGood",
    }
    assert glove.responder.command is None, (
        "a command of the process must not be given by somebody who says no"
    )
    glove.responder.end()
    view = view_of(glove, hand.now_s)
    assert view["message"]["key"] == "answeredNotGood"
    assert (view["answered"]["outcome"], view["answered"]["gesture"]) == ("notGood", "Horns")


async def test_the_view_lists_the_other_answers_with_the_gesture_of_each(glove: Glove, ask: Ask) -> None:
    ask("Thumbs up", answers={Outcome.PROBLEM: "Ring straight"})
    assert view_of(glove, 0)["task"]["answers"] == [
        {"outcome": "notGood", "gesture": None, "code": None, "parts": []},
        {"outcome": "problem", "gesture": "Ring straight", "code": "22202", "parts": []},
    ]


async def test_an_answer_gesture_held_for_one_task_does_not_answer_the_next(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    answers = {Outcome.NOT_GOOD: "Horns"}
    ask("Thumbs up", answers=answers)
    hand.show("Horns", 1.6)
    glove.responder.end()
    again = ask("Thumbs up", "t2", answers=answers)
    hand.show("Horns", 3)
    assert not again.answer.done()
    hand.show(None, 0.2)
    hand.show("Horns", 1.6)
    assert again.answer.result().outcome is Outcome.NOT_GOOD


async def test_an_answer_gesture_counts_as_little_as_any_while_paused_or_testing(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    prompt = ask("Thumbs up", answers={Outcome.PROBLEM: "Horns"})
    glove.pause()
    hand.show("Horns", 2)
    glove.resume()
    hand.show(None, 0.2)
    glove.switch(testing=True, filtering=None)
    hand.show("Horns", 2)
    assert not prompt.answer.done()


async def test_an_outcome_on_the_screen_is_kept_with_its_note(glove: Glove, hand: Any, ask: Ask) -> None:
    prompt = ask("Thumbs up")
    glove.responder.complete_on_screen("Anna", hand.now_s, outcome=Outcome.PROBLEM, note="oil on the belt")
    answer = prompt.answer.result()
    outputs = {
        "heldMs": 0,
        "by": "screen",
        "operator": "Anna",
        "outcome": "problem",
        "note": "oil on the belt",
    }
    assert answer.outputs() == outputs
    assert answer.failure().reason == 'answered "problem": oil on the belt'
    assert answer.failure().outputs == {**outputs, "errorCode": "problem"}
    assert glove.responder.command is None


async def test_a_task_that_demands_a_pin_is_answered_by_nothing_before_it_was_given(
    glove: Glove, hand: Any, ask: Ask
) -> None:
    anna, ben = "urn:ngsi-ld:Person:demo:anna", "urn:ngsi-ld:Person:demo:ben"
    present: list[str | None] = [anna]
    glove.responder.station = Station(lambda: present[0])
    prompt = ask("Thumbs up")
    prompt.spec = replace(prompt.spec, requires_pin=True)
    hand.show("Thumbs up", 3)
    assert not prompt.answer.done()
    view = view_of(glove, hand.now_s)
    assert (view["message"]["key"], view["task"]["needsPin"]) == ("needsPin", True)
    with pytest.raises(CannotComplete, match="needs a PIN"):
        glove.responder.complete_on_screen("Anna", hand.now_s, performed_by=anna)
    glove.responder.give_pin(ProvenPin(anna, "the-proof"))
    present[0] = ben
    hand.show("Thumbs up", 3)
    assert not prompt.answer.done(), "another person has joined"
    with pytest.raises(CannotComplete, match="needs a PIN"):
        glove.responder.complete_on_screen("Ben", hand.now_s, performed_by=ben)
    present[0] = anna
    assert view_of(glove, hand.now_s)["task"]["needsPin"] is False
    hand.show(None, 0.5)
    hand.show("Thumbs up", 1.6)
    outputs = prompt.answer.result().outputs()
    assert (outputs["performedBy"], outputs["pinProof"]) == (anna, "the-proof")
