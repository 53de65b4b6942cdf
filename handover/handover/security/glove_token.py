"""The token of all gloves of a site, as far as they have none of their own.

It is a setting (`HANDOVER_GLOVE_TOKEN`). On a machine with accounts every glove needs a token, also on
loopback; so setting up accounts makes one in the security directory, which the gesture controller, the
simulated operator and `handover glove` of the same machine read. Where secrets are files of their own
(`HANDOVER_SECRETS_DIR`, as in containers), the token is one of these, since all services read the security
directory.
"""

from pathlib import Path
from typing import Final

from pydantic import SecretStr

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.security.secret_tokens import new_token
from handover.telemetry import get_logger

log = get_logger(__name__)

GLOVE_TOKEN_FILE: Final = "glove-token"  # noqa: S105 - the name of a file
GLOVE_TOKEN_SECRET: Final = "HANDOVER_GLOVE_TOKEN"  # noqa: S105 - the name of a setting


def site_glove_token(token: SecretStr | None, folder: Path) -> str | None:
    """Return the token of the setting, else that in the security directory `folder`; None without one."""
    if token is not None and token.get_secret_value():
        return token.get_secret_value()
    try:
        return (folder / GLOVE_TOKEN_FILE).read_text(encoding="utf-8").strip() or None
    except OSError:  # none was made, or it is for the user of another service
        return None


def remove_glove_token(folder: Path) -> None:
    """Remove the token from the security directory, where the setting has another. Raises `UsageError`."""
    file = folder / GLOVE_TOKEN_FILE
    try:
        file.unlink()
    except FileNotFoundError:
        return
    except OSError as error:
        raise UsageError(f"the unused token of gloves, {file}, cannot be removed: {error.strerror}") from None
    log.warning("unused token of gloves removed: services that need none could read it", file=str(file))


def make_glove_token(folder: Path) -> None:
    """Make the token in the security directory unless there is one. Raises `UsageError`."""
    file = folder / GLOVE_TOKEN_FILE
    if file.exists():
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_durably(file, f"{new_token('glove')}\n".encode(), mode=0o600)
    except OSError as error:
        raise UsageError(f"the token of gloves cannot be written to {file}: {error.strerror}") from None
