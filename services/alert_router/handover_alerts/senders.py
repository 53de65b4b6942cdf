"""Senders: one message to one channel. Each raises `NotSent`, with `is_final` if repeating is of no use."""

import asyncio
import hashlib
import hmac
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from email.headerregistry import Address
from email.message import EmailMessage
from email.utils import formatdate
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import aiosmtplib
import orjson

from handover.errors import UsageError
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.network.outbound_policy import AddressRefused, is_loopback
from handover.network.tls_trust import client_context
from handover_alerts.model.configuration import AppriseChannel, Channel, MailChannel, WebhookChannel
from handover_alerts.settings import RouterSettings

MAX_ANSWER_BYTES: Final = 64 * 1024
MAX_SUBJECT: Final = 200
SEND_TIMEOUT_S: Final = 30.0
"""A server that takes longer to accept a message is tried again later."""


class NotSent(Exception):
    """A message was not accepted; `is_final`: it never will be."""

    def __init__(self, reason: str, *, is_final: bool = False) -> None:
        super().__init__(reason)
        self.is_final = is_final


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A message to send: a text for people, and the Alerts in it as JSON for programs."""

    id: str
    subject: str
    text: str
    alerts: Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class MailServer:
    """The mail server and as whom we connect."""

    host: str
    port: int
    is_tls: bool
    username: str | None
    password: str | None

    @classmethod
    def of(cls, settings: RouterSettings) -> "MailServer | None":
        """Return the server of HANDOVER_SMTP_URL, None without one; raise `UsageError`."""
        if not settings.smtp_url:
            return None
        try:
            parts = urlsplit(settings.smtp_url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urlsplit("")
        if parts.scheme not in {"smtp", "smtps"} or not host:
            raise UsageError(
                "HANDOVER_SMTP_URL is no address of a mail server; write smtps://user@mail.example:465 or "
                "smtp://user@mail.example:587"
            )
        is_tls = parts.scheme == "smtps"
        secret = settings.smtp_password.get_secret_value() if settings.smtp_password else ""
        password_of_url = unquote(parts.password) if parts.password else None
        return cls(
            host,
            port or (465 if is_tls else 587),
            is_tls,
            unquote(parts.username) if parts.username else None,
            secret or password_of_url,
        )


class Senders:
    """Sends to channels of every type."""

    def __init__(self, settings: RouterSettings) -> None:
        self._settings = settings
        self._server = MailServer.of(settings)
        self._http = BodyReadingHttpClient(settings.outbound_policy(), settings.ca_files, MAX_ANSWER_BYTES)

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    async def send(self, channel: Channel, message: Outgoing) -> None:
        """Send a message; raise `NotSent`. It takes no longer than `SEND_TIMEOUT_S`."""
        try:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                if isinstance(channel, MailChannel):
                    await self._send_mail(channel, message)
                elif isinstance(channel, WebhookChannel):
                    await self._send_webhook(channel, message)
                else:
                    await _send_by_apprise(channel, message)
        except TimeoutError:
            raise NotSent(f"no answer within {SEND_TIMEOUT_S:g} s") from None

    async def _send_mail(self, channel: MailChannel, message: Outgoing) -> None:
        server = self._server
        if server is None:
            raise NotSent("there is no mail server; set HANDOVER_SMTP_URL")
        mail = EmailMessage()
        mail["From"] = self._settings.smtp_sender
        mail["To"] = ", ".join(channel.to)
        mail["Subject"] = one_line(message.subject)[:MAX_SUBJECT]
        mail["Date"] = formatdate(usegmt=True)
        # The same after a repeated attempt, so that mail programs can show it once.
        mail["Message-ID"] = f"<{message.id}@{_domain_of(self._settings.smtp_sender)}>"
        mail["Auto-Submitted"] = "auto-generated"
        mail.set_content(message.text)
        may_be_plain = self._settings.smtp_plain or is_loopback(server.host)
        try:
            await aiosmtplib.send(
                mail,
                hostname=server.host,
                port=server.port,
                username=server.username,
                password=server.password,
                use_tls=server.is_tls,
                start_tls=False if server.is_tls else None if may_be_plain else True,
                tls_context=client_context(*self._settings.ca_files),
                timeout=SEND_TIMEOUT_S,
            )
        except aiosmtplib.SMTPRecipientsRefused as refused:
            is_final = all(recipient.code >= 500 for recipient in refused.recipients)
            raise NotSent(f"the mail server refuses every recipient: {refused}", is_final=is_final) from None
        except aiosmtplib.SMTPAuthenticationError as error:
            raise NotSent(f"the mail server refuses user or password: {error.message}") from None
        except aiosmtplib.SMTPResponseException as error:
            raise NotSent(
                f"the mail server answers {error.code}: {error.message}", is_final=error.code >= 500
            ) from None
        except (aiosmtplib.SMTPException, OSError) as error:
            raise NotSent(str(error) or type(error).__name__) from None

    async def _send_webhook(self, channel: WebhookChannel, message: Outgoing) -> None:
        document = {"id": message.id, "subject": message.subject, "text": message.text}
        body = orjson.dumps({**document, "alerts": list(message.alerts)})
        headers = [("Content-Type", "application/json"), ("Handover-Message-Id", message.id)]
        if channel.secret is not None:
            key = channel.secret.get_secret_value().encode()
            headers.append(
                ("Handover-Signature", f"sha256={hmac.new(key, body, hashlib.sha256).hexdigest()}")
            )
        try:
            response = await self._http.request("POST", channel.url, headers, body, SEND_TIMEOUT_S)
        except AddressRefused as refused:
            raise NotSent(str(refused), is_final=True) from None
        except (SendError, OSError) as error:
            raise NotSent(str(error) or type(error).__name__) from None
        if response.status >= 300:
            is_final = 300 <= response.status < 500 and response.status not in {408, 429}
            raise NotSent(f"the receiver answers {response.status}", is_final=is_final)


async def _send_by_apprise(channel: AppriseChannel, message: Outgoing) -> None:
    try:
        import apprise  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotSent("Apprise is not installed; install the extra messengers of handover-cell") from None

    def send() -> bool:
        messenger = apprise.Apprise()
        if not messenger.add(channel.url.get_secret_value()):
            raise NotSent("Apprise does not know this URL", is_final=True)
        return bool(messenger.notify(title=one_line(message.subject), body=message.text))

    if not await asyncio.to_thread(send):
        raise NotSent("the messenger did not accept the message")


def one_line(text: str) -> str:
    """Return a text without line ends and other control characters, for headers."""
    return " ".join("".join(character if character.isprintable() else " " for character in text).split())


def _domain_of(address: str) -> str:
    try:
        return Address(addr_spec=address).domain or "localhost"
    except (ValueError, IndexError):
        return "localhost"
