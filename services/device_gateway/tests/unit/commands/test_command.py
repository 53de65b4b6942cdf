"""Commands: sent, sent again, ended. A motion reaches a device once at most."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from handover_devices.commands.command import (
    Command,
    CommandState,
    Sent,
    Step,
    answered,
    next_step,
)
from handover_devices.model.description import CommandKind
from handover_devices.protocol.messages import AnswerState, CommandAnswer

ACK_S = 2.0


def command(kind: CommandKind, **changes: object) -> Command:
    made = Command("d", "c", "act", kind, {}, created_s=0.0, deadline_s=100.0)
    return replace(made, **changes)  # type: ignore[arg-type]


class SimulatedDevice:
    """A program that remembers the ids of its run; `executions` counts them over all runs."""

    def __init__(self) -> None:
        self.boot = 0
        self.known: set[str] = set()
        self.executions: list[int] = []

    def restart(self) -> None:
        self.boot += 1
        self.known.clear()

    def receive(self, identifier: str) -> None:
        if identifier not in self.known:
            self.known.add(identifier)
            self.executions.append(self.boot)


EVENTS = st.lists(
    st.sampled_from(["wait", "long wait", "lose link", "connect", "restart", "lost", "accept", "done"]),
    max_size=40,
)


@given(st.sampled_from(CommandKind), EVENTS)
def test_a_command_is_executed_once_at_most_unless_it_is_a_setting(
    kind: CommandKind, events: list[str]
) -> None:
    device, now_s, is_connected = SimulatedDevice(), 0.0, True
    one, sent, sendings = command(kind), Sent(), 0
    if kind is CommandKind.MOTION:  # created while connected, and sent at once
        one, sent, sendings = one.sent_to("0"), Sent(1, 0.0), 1
        device.receive(one.id)
    for event in events:
        now_s += 30.0 if event == "long wait" else 1.0
        if event == "lose link":
            is_connected = False
        elif event in {"connect", "restart"}:
            if event == "restart":
                device.restart()
            is_connected, sent = True, Sent()
        elif event in {"accept", "done"} and is_connected and one.id in device.known:
            state = AnswerState.ACCEPTED if event == "accept" else AnswerState.DONE
            one = answered(one, CommandAnswer(one.id, state))
        step = next_step(one, now_s, str(device.boot) if is_connected else None, sent, ACK_S)
        if step is Step.SEND:
            one, sent, sendings = one.sent_to(str(device.boot)), Sent(sent.times + 1, now_s), sendings + 1
            if event != "lost":  # otherwise the message is lost on its way
                device.receive(one.id)
        elif step in {Step.EXPIRE, Step.GIVE_UP}:
            one = one.ended(CommandState.EXPIRED, "")
    if kind is CommandKind.MOTION:
        assert sendings == 1
    if kind is CommandKind.SETTING:
        assert len(device.executions) == len(set(device.executions))  # once in each run
    else:
        assert len(device.executions) <= 1


def test_an_unanswered_action_is_sent_again_after_growing_delays() -> None:
    one, sent = command(CommandKind.ACTION).sent_to("b"), Sent(1, 0.0)
    assert next_step(one, 1.9, "b", sent, ACK_S) is Step.WAIT
    assert next_step(one, 2.0, "b", sent, ACK_S) is Step.SEND
    assert next_step(one, 5.9, "b", Sent(2, 2.0), ACK_S) is Step.WAIT
    assert next_step(one, 6.0, "b", Sent(2, 2.0), ACK_S) is Step.SEND
    accepted = answered(one, CommandAnswer("c", AnswerState.ACCEPTED))
    assert next_step(accepted, 90.0, "b", sent, ACK_S) is Step.WAIT
    assert next_step(accepted, 100.0, "b", sent, ACK_S) is Step.EXPIRE


def test_a_new_run_of_the_program_ends_what_may_have_been_executed() -> None:
    for kind, step in (
        (CommandKind.MOTION, Step.GIVE_UP),
        (CommandKind.ACTION, Step.GIVE_UP),
        (CommandKind.SETTING, Step.SEND),
    ):
        assert next_step(command(kind).sent_to("b1"), 1.0, "b2", Sent(), ACK_S) is step
    assert next_step(command(CommandKind.ACTION), 1.0, "b2", Sent(), ACK_S) is Step.SEND


def test_the_first_final_answer_counts() -> None:
    one = command(CommandKind.ACTION).sent_to("b")
    running = answered(one, CommandAnswer("c", AnswerState.RUNNING, 0.4))
    assert (running.state, running.progress) == (CommandState.RUNNING, 0.4)
    assert answered(running, CommandAnswer("c", AnswerState.ACCEPTED)).state is CommandState.RUNNING
    done = answered(running, CommandAnswer("c", AnswerState.DONE, result={"at": 3}))
    assert (done.state, done.progress, done.result) == (CommandState.DONE, 1.0, {"at": 3})
    assert answered(done, CommandAnswer("c", None, reason="late")) is done
    failed = answered(one, CommandAnswer("c", None, reason="blocked"))
    assert (failed.state, failed.reason) == (CommandState.FAILED, "blocked")
    stopped = answered(one, CommandAnswer("c", None, reason="stopped"), is_cancelling=True)
    assert stopped.state is CommandState.CANCELLED
