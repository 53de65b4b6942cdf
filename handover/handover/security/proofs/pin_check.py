"""The PIN that a Task may demand (`requirePin`): `accounts` says whether it is that of the person.

A PIN identifies the person at a station more surely than a badge that can be lent; it gives no right. After
too many attempts `accounts` refuses others for a while, never for ever.

The PIN counts whatever broker stores the Task: `accounts` signs a proof for this Person and this Task, the
service that answers the Task writes it into `outputParameters.pinProof`, and the orchestrator verifies it
before the Task counts as completed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from handover.errors import Problem, UsageError
from handover.messages import message
from handover.security.audit_trail import current_request
from handover.security.authentication import Guard
from handover.security.caller import Caller, InvalidToken
from handover.security.keys_in_force import KeysInForce
from handover.security.service_access import AccountsUnavailable

PIN_METHOD: Final = "pin"
PIN_REQUIRED: Final = "urn:handover:pin-required"
WRONG_PIN: Final = "urn:handover:wrong-pin"
MAX_PIN_CHARACTERS: Final = 12
PROOF_MEMBER: Final = "pinProof"
"""The member of `outputParameters` with the proof."""


@dataclass(frozen=True, slots=True)
class ProvenPin:
    """The PIN of `person` was given for a Task; `proof` shows it to other services."""

    person: str
    proof: str


async def require_pin(guard: Guard, caller: Caller, pin: str | None, task: str) -> ProvenPin:
    """Return whose PIN was given for the Task `task`: that of `caller`. The audit record names the method.

    Raises `Problem`: 403 without a PIN, with a wrong one, or if the caller is no Person; 429 after too many
    attempts; 503 if `accounts` does not answer.
    """
    if not guard.has_accounts():
        raise _refused(
            message(
                "pin.no_accounts",
                "this task needs a PIN, and without accounts nobody has one; set up accounts on the "
                "page People",
            )
        )
    if caller.person is None:
        raise _refused(
            message(
                "pin.no_person",
                "this task needs the PIN of a person, and nobody is here; join the station, or sign in",
            )
        )
    if not pin:
        raise _refused(message("pin.required", "this task needs your PIN; enter it on the screen"))
    try:
        document = await guard.access.call(
            "POST", "/pin-checks", {"person": caller.person, "pin": pin, "task": task}
        )
    except (AccountsUnavailable, UsageError) as error:
        problem = getattr(error, "problem", None) or {}
        if problem.get("status") == 429:
            raise Problem(
                429,
                "Too many attempts",
                str(problem.get("detail", "")),
                extra={"retryAfterS": problem.get("retryAfterS", 60)},
            ) from None
        raise Problem(503, "Accounts unavailable", "the PIN cannot be checked now; try again") from None
    act = current_request()
    if act is not None:
        act.method = PIN_METHOD
    if document.get("isRight") is not True:
        raise Problem(403, "Wrong PIN", message("pin.wrong", "this is not your PIN; try again"), WRONG_PIN)
    return ProvenPin(caller.person, str(document["proof"]))


def proven_person(keys: KeysInForce, task: str, outputs: Mapping[str, Any]) -> str:
    """Return the Person who has given the own PIN for the Task `task`, by the proof in its outputs.

    Raises `InvalidToken` with the reason if there is none, or one of another Task.
    """
    names = keys.keys()
    if names is None:
        raise InvalidToken("without accounts nobody has a PIN")
    proof = outputs.get(PROOF_MEMBER)
    if not isinstance(proof, str):
        raise InvalidToken("there is no proof")
    return names.pin_person(proof, task)


def _refused(why: str) -> Problem:
    return Problem(403, "PIN required", why, PIN_REQUIRED)
