"""Study conditions: whose gestures a participant of a study is asked for."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from handover.errors import Problem


@dataclass(frozen=True, slots=True)
class StudyCondition:
    """Whose gestures a participant is asked for: their `own`, the site's, or the usual ones (None)."""

    participant: str
    """The pseudonym."""
    glove: str | None
    person: str | None
    own: bool | None = None

    def overlaps(self, other: "StudyCondition") -> bool:
        """Return True if both concern the same glove or the same person."""
        same_glove = self.glove is not None and self.glove == other.glove
        return same_glove or (self.person is not None and self.person == other.person)


class StudyConditions:
    """The conditions by study session; of the same glove or person, the newest one counts."""

    def __init__(self, conditions: Mapping[str, StudyCondition]) -> None:
        self._conditions = dict(conditions)

    def items(self) -> Iterable[tuple[str, StudyCondition]]:
        """Return sessions and conditions, the latest last."""
        return self._conditions.items()

    def get(self, session: str) -> StudyCondition | None:
        """Return the condition of a session, if any."""
        return self._conditions.get(session)

    def set(self, session: str, condition: StudyCondition) -> None:
        """Add a condition; older ones of the same glove or person are dropped."""
        self._conditions = {
            key: older
            for key, older in self._conditions.items()
            if key != session and not older.overlaps(condition)
        } | {session: condition}

    def remove(self, session: str) -> bool:
        """Remove the condition of a session; return False if it has none."""
        return self._conditions.pop(session, None) is not None

    def find(self, glove: str | None, person: str | None) -> StudyCondition | None:
        """Return the condition of a glove or a person that decides whose gestures count, if any."""
        requested = StudyCondition("", glove, person)
        overlapping = (condition for condition in self._conditions.values() if condition.overlaps(requested))
        return next((condition for condition in overlapping if condition.own is not None), None)

    def require_none(self, *, glove: str | None = None, person: str | None = None) -> None:
        """Raise `Problem` 409 if a study decides whose gestures count for one of them."""
        condition = self.find(glove, person)
        if condition is not None:
            raise Problem.translated(
                409,
                "Study under way",
                "people.in_study",
                "{participant} tries gestures in a study, so what {who} shows cannot change until this "
                "part is over; finish it on the page Studies, or delete the session there",
                participant=condition.participant,
                who=person or glove,
            )
