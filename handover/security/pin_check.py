"""The PIN that a Task may demand (`requirePin`): `accounts` says whether it is that of the person.

A PIN identifies the person at a station more surely than a badge that can be lent; it gives no right. After
too many attempts `accounts` refuses others for a while, never for ever.
"""

from typing import Final

from handover.errors import Problem, UsageError
from handover.messages import message
from handover.security.audit_trail import current_request
from handover.security.authentication import Guard
from handover.security.caller import Caller
from handover.security.service_access import AccountsUnavailable

PIN_METHOD: Final = "pin"
PIN_REQUIRED: Final = "urn:handover:pin-required"
WRONG_PIN: Final = "urn:handover:wrong-pin"
MAX_PIN_CHARACTERS: Final = 12


async def require_pin(guard: Guard, caller: Caller, pin: str | None) -> str:
    """Return the Person of `caller`, whose PIN was given; the audit record names the method.

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
        document = await guard.access.call("POST", "/pin-checks", {"person": caller.person, "pin": pin})
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
    return caller.person


def _refused(why: str) -> Problem:
    return Problem(403, "PIN required", why, PIN_REQUIRED)
