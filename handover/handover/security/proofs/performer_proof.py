"""Who performed a Task, in a way that holds whatever broker stores the Task.

The service that answers a Task for a person whom it has identified asks `accounts` for a proof, which names
this Person and this one Task, and writes it into `outputParameters.performerProof`. The orchestrator takes
`performedBy` from the broker with a proof only: a broker without our rules accepts it from any program.

The proof says that one of our services has identified the person, not how surely: see the audit, and
`pin_check` for a Task that demands a PIN. What proves the PIN proves the performer, too.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from handover.errors import UsageError
from handover.security.authentication import Guard
from handover.security.caller import InvalidToken
from handover.security.proofs.pin_check import PROOF_MEMBER as PIN_PROOF_MEMBER
from handover.security.service_access import AccountsUnavailable
from handover.telemetry import get_logger

if TYPE_CHECKING:
    from handover.security.access_tokens import PublicKeys

log = get_logger(__name__)

PERFORMER_MEMBER: Final = "performedBy"
"""The member of `outputParameters` with the id of the Person."""
PROOF_MEMBER: Final = "performerProof"
"""The member of `outputParameters` with the proof."""


async def performer_proof(guard: Guard, person: str, task: str) -> str | None:
    """Return the proof that `person` performed `task`; None in local mode, or if `accounts` gives none."""
    if not guard.has_accounts():
        return None
    try:
        document = await guard.access.call("POST", "/performer-proofs", {"person": person, "task": task})
        return str(document["proof"])
    except (AccountsUnavailable, UsageError, KeyError) as error:
        log.warning("who performed a task cannot be proved", task=task, reason=str(error))
        return None


def require_proven_performer(keys: "PublicKeys", task: str, outputs: Mapping[str, Any]) -> None:
    """Raise `InvalidToken` with the reason unless `outputs` prove their `performedBy`."""
    pin, proof = outputs.get(PIN_PROOF_MEMBER), outputs.get(PROOF_MEMBER)
    if isinstance(proof, str):
        person = keys.performer(proof, task)
    elif isinstance(pin, str):
        person = keys.pin_person(pin, task)
    else:
        raise InvalidToken("there is no proof")
    if outputs.get(PERFORMER_MEMBER) != person:
        raise InvalidToken("the proof is of another person")
