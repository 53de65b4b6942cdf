"""Why a device is not let in: the token, the certificate, or the hello as a whole."""

from handover.errors import HandoverError
from handover.messages import message


class WrongToken(HandoverError):
    """There is no such device, or the token is not its token: one text for both, so that nobody finds out
    which devices exist."""

    code = "wrongToken"

    def __init__(self) -> None:
        super().__init__(
            message(
                "device.wrong_token",
                "there is no such device, or the token is not its token; add the device with `handover "
                "device add`, or make a new token with `handover device token`",
            )
        )


class WrongCertificate(HandoverError):
    """The certificate belongs to no device of this name."""

    code = "wrongCertificate"

    def __init__(self) -> None:
        super().__init__(
            message(
                "device.wrong_certificate",
                "there is no such device, or the certificate is not its certificate; make one with `handover "
                "device certificate`, or send the token of the device",
            )
        )


class HelloRefused(Exception):
    """A hello is refused; `retry` says whether the device should try again."""

    def __init__(self, code: str, reason: str, *, retry: bool = False) -> None:
        super().__init__(reason)
        self.code = code
        self.retry = retry
