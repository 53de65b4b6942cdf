"""A gesture of both hands counts when both hold it, as long as one hand would, and never by one alone."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.prompting.two_hand_gesture import ShownHand, TwoHandProgress
from handover_gloves.recognition.gestures import TwoHandGesture
from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming

TIMING = HoldTiming(500, 1500, 250, 100)
ASKED = TwoHandGesture("A", "B")
ANNOUNCED, CONFIRMED = HoldEvent.ANNOUNCED, HoldEvent.CONFIRMED


@dataclass
class Hands:
    """A left and a right hand; their gloves' clocks have nothing to do with each other."""

    now_s: float = 100.0
    together: TwoHandProgress = field(default_factory=TwoHandProgress)
    holds: dict[str, Hold] = field(default_factory=lambda: {"left": Hold(), "right": Hold()})
    at_s: dict[str, float] = field(default_factory=dict)
    ahead_s: dict[str, float] = field(default_factory=lambda: {"left": 5.0, "right": 9000.0})

    def frame(self, hand: str, gesture: str | None) -> HoldEvent:
        self.holds[hand] = self.holds[hand].after(gesture, self.now_s + self.ahead_s[hand], TIMING)
        self.at_s[hand] = self.now_s
        shown = {one: ShownHand(self.holds[one], at_s) for one, at_s in self.at_s.items()}
        self.together = self.together.after(
            ASKED, shown.get("left"), shown.get("right"), now_s=self.now_s, timing=TIMING
        )
        return self.together.last

    def show(
        self, left: str | None, right: str | None, seconds: float, *, silent: str = ""
    ) -> list[HoldEvent]:
        events = []
        for _ in range(round(seconds * 50)):
            self.now_s = round(self.now_s + 0.02, 3)
            for hand, gesture in (("left", left), ("right", right)):
                if hand != silent and (event := self.frame(hand, gesture)) is not HoldEvent.NONE:
                    events.append(event)
        return events


def test_both_hands_held_count_from_the_later_one_on() -> None:
    hands = Hands()
    hands.show("A", None, 1.0)
    assert hands.show("A", "B", 1.4) == [ANNOUNCED]
    assert hands.show("A", "B", 0.2) == [CONFIRMED]


def test_one_hand_alone_or_the_hands_exchanged_never_count() -> None:
    hands = Hands()
    assert hands.show("A", None, 5) == []
    assert hands.show(None, "B", 5) == []
    assert hands.show("B", "A", 5) == []


def test_a_hand_that_had_long_been_resting_so_must_let_go_first() -> None:
    hands = Hands()
    hands.show("A", None, 2.5)
    assert hands.show("A", "B", 5) == []
    assert hands.together.apart
    hands.show(None, "B", 0.1)
    assert hands.show("A", "B", 3) == []  # now the other one has been there too long
    hands.show(None, None, 0.1)
    assert hands.show("A", "B", 1.6) == [ANNOUNCED, CONFIRMED]


def test_a_hand_that_falls_silent_breaks_it() -> None:
    hands = Hands()
    hands.show("A", "B", 1.2)
    assert hands.show("A", "B", 1.0, silent="left") == []
    assert hands.together.held_ms == 0


def test_hands_that_have_counted_must_let_go() -> None:
    hands = Hands()
    hands.show("A", "B", 1.6)
    hands.holds = {hand: hold.mark_spent() for hand, hold in hands.holds.items()}
    assert hands.show("A", "B", 5) == []
    hands.show(None, None, 0.3)
    assert hands.show("A", "B", 1.6) == [ANNOUNCED, CONFIRMED]


MOVES = st.lists(
    st.tuples(
        st.sampled_from(["A", "B", None]),
        st.sampled_from(["A", "B", None]),
        st.integers(1, 120),
        st.sampled_from(["", "", "", "left", "right"]),
    ),
    max_size=10,
)


@given(MOVES)
def test_whatever_hands_do_both_have_held_their_parts_for_1500_ms_when_it_counts(
    moves: list[tuple[str | None, str | None, int, str]],
) -> None:
    hands = Hands()
    since_s: dict[str, float | None] = {"left": None, "right": None}
    part = {"left": "A", "right": "B"}
    for left, right, count, silent in moves:
        for _ in range(count):
            hands.now_s = round(hands.now_s + 0.02, 3)
            for hand, gesture in (("left", left), ("right", right)):
                if hand == silent:
                    continue
                if gesture != part[hand] or hands.now_s - hands.at_s.get(hand, -1.0) > 0.2501:
                    since_s[hand] = None
                if gesture == part[hand] and since_s[hand] is None:
                    since_s[hand] = hands.now_s
                if hands.frame(hand, gesture) is CONFIRMED:
                    begins = [began for began in since_s.values() if began is not None]
                    assert len(begins) == 2
                    assert round((hands.now_s - max(begins)) * 1000) >= 1500 - 250
                    assert min(one.held_ms for one in hands.holds.values()) >= 1500
