"""An OpenID Connect provider: Django OAuth Toolkit, with its own database, login page and keys, on a port.

Django has one configuration in a process, so all tests of a process share one provider. Users, groups and
clients are made by each test.
"""

import re
import secrets
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from socketserver import ThreadingMixIn
from tempfile import mkdtemp
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urlsplit
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import httpx

from handover.security.secret_tokens import new_token

PASSWORD = "a password at the provider"
Given, Result = ParamSpec("Given"), TypeVar("Result")


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _Quiet(WSGIRequestHandler):
    def log_message(self, format: str, *_: Any) -> None:  # noqa: A002
        pass


@dataclass(frozen=True)
class Client:
    """A client that is registered at the provider."""

    client_id: str
    secret: str | None


def _outside_the_event_loop(act: Callable[Given, Result]) -> Callable[Given, Result]:
    """Run `act` in a thread of its own: Django refuses to use its database where an event loop runs."""

    @wraps(act)
    def run(*given: Given.args, **named: Given.kwargs) -> Result:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(act, *given, **named).result()

    return run


class OpenIdProvider:
    """The provider at `issuer`."""

    def __init__(self, issuer: str) -> None:
        self.issuer = issuer

    @_outside_the_event_loop
    def add_client(self, *redirect_uris: str, algorithm: str = "RS256", is_public: bool = False) -> Client:
        from oauth2_provider.models import Application

        client_id, secret = secrets.token_hex(8), new_token("client")
        Application.objects.create(
            client_id=client_id,
            client_secret=secret,
            hash_client_secret=algorithm == "RS256",
            client_type="public" if is_public else "confidential",
            authorization_grant_type="authorization-code",
            redirect_uris=" ".join(redirect_uris),
            post_logout_redirect_uris=" ".join(
                f"{urlsplit(uri).scheme}://{urlsplit(uri).netloc}/" for uri in redirect_uris
            ),
            algorithm=algorithm,
            skip_authorization=True,
            name="Handover",
        )
        return Client(client_id, None if is_public else secret)

    @_outside_the_event_loop
    def add_program(self) -> Client:
        """Register a client that gets tokens for itself (client credentials)."""
        from oauth2_provider.models import Application

        client_id, secret = secrets.token_hex(8), f"{new_token('client')}+/=% :"
        Application.objects.create(
            client_id=client_id,
            client_secret=secret,
            client_type="confidential",
            authorization_grant_type="client-credentials",
            name="A program",
        )
        return Client(client_id, secret)

    @_outside_the_event_loop
    def accepts(self, token: str) -> bool:
        """Return whether a token was issued here and is valid."""
        from oauth2_provider.models import AccessToken

        found = AccessToken.objects.filter(token=token).first()
        return found is not None and bool(found.is_valid())

    @_outside_the_event_loop
    def revoke(self, token: str) -> None:
        """Make a token invalid before its time."""
        from oauth2_provider.models import AccessToken

        AccessToken.objects.get(token=token).revoke()

    @_outside_the_event_loop
    def add_user(self, name: str, *groups: str) -> str:
        """Add a person; return the subject at this provider."""
        from django.contrib.auth.models import User

        user = User.objects.create_user(name, f"{name}@example.org", PASSWORD)
        _set_groups(name, groups)
        return str(user.pk)

    @_outside_the_event_loop
    def set_groups(self, name: str, *groups: str) -> None:
        _set_groups(name, groups)

    def sign_in(self, location: str, name: str, browser: httpx.Client | None = None) -> httpx.URL:
        """Sign a person in at `location` as a browser does; return the address that it is sent back to."""
        own = urlsplit(self.issuer).netloc
        with httpx.Client(trust_env=False, timeout=60) if browser is None else _Borrowed(browser) as http:
            answer = http.get(location)
            for _ in range(10):
                if answer.is_redirect:
                    target = answer.url.join(answer.headers["location"])
                    if target.netloc.decode() != own:
                        return target
                    answer = http.get(target)
                    continue
                assert answer.status_code == 200, answer.text
                token = re.search(r'name="csrfmiddlewaretoken" value="([^"]+)"', answer.text)
                assert token is not None, answer.text
                form = {"csrfmiddlewaretoken": token[1], "username": name, "password": PASSWORD}
                answer = http.post(answer.url, data=form, headers={"Referer": str(answer.url)})
        raise AssertionError(f"the provider does not send the browser back: {answer.url}")


def _set_groups(name: str, groups: Sequence[str]) -> None:
    from django.contrib.auth.models import Group, User

    made = [Group.objects.get_or_create(name=group)[0] for group in groups]
    User.objects.get(username=name).groups.set(made)


class _Borrowed:
    """A client that its owner closes."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    def __enter__(self) -> httpx.Client:
        return self._http

    def __exit__(self, *_: object) -> None:
        pass


@cache
@_outside_the_event_loop
def openid_provider() -> OpenIdProvider:
    """Return the provider of this process; it serves until the process ends."""
    server = make_server("127.0.0.1", 0, lambda *_: [], server_class=_Server, handler_class=_Quiet)
    issuer = f"http://127.0.0.1:{server.server_port}"
    _configure(Path(mkdtemp(prefix="handover-openid-")) / "provider.db", issuer)
    from django.core.management import call_command
    from django.core.wsgi import get_wsgi_application

    server.set_app(get_wsgi_application())
    call_command("migrate", verbosity=0)
    threading.Thread(target=server.serve_forever, name="openid provider", daemon=True).start()
    return OpenIdProvider(issuer)


def _configure(database: Path, issuer: str) -> None:
    from cryptography.hazmat.primitives.asymmetric.rsa import generate_private_key
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
    from django.conf import settings

    key = generate_private_key(65537, 2048)
    settings.configure(
        SECRET_KEY=secrets.token_hex(),
        ALLOWED_HOSTS=["127.0.0.1"],
        ROOT_URLCONF="tests.kit.openid_provider_urls",
        USE_TZ=True,
        LOGIN_URL="/login/",
        DEFAULT_AUTO_FIELD="django.db.models.AutoField",
        PASSWORD_HASHERS=["django.contrib.auth.hashers.MD5PasswordHasher"],
        INSTALLED_APPS=[
            "django.contrib.auth",
            "django.contrib.contenttypes",
            "django.contrib.sessions",
            "oauth2_provider",
        ],
        MIDDLEWARE=[
            "django.contrib.sessions.middleware.SessionMiddleware",
            "django.middleware.csrf.CsrfViewMiddleware",
            "django.contrib.auth.middleware.AuthenticationMiddleware",
        ],
        TEMPLATES=[
            {
                "BACKEND": "django.template.backends.django.DjangoTemplates",
                "APP_DIRS": True,
                "OPTIONS": {"context_processors": ["django.template.context_processors.request"]},
            }
        ],
        DATABASES={
            "default": {
                "ENGINE": "django.db.backends.sqlite3",
                "NAME": str(database),
                "OPTIONS": {"timeout": 60},
            }
        },
        OAUTH2_PROVIDER={
            "OIDC_ENABLED": True,
            "OIDC_ISS_ENDPOINT": issuer,
            "OIDC_RSA_PRIVATE_KEY": key.private_bytes(
                Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
            ).decode(),
            "OIDC_RP_INITIATED_LOGOUT_ENABLED": True,
            "OIDC_RP_INITIATED_LOGOUT_ALWAYS_PROMPT": False,
            "OAUTH2_VALIDATOR_CLASS": "tests.kit.openid_provider_urls.Validator",
            "SCOPES": {"openid": "Identity", "profile": "Name", "email": "Address"},
            "PKCE_REQUIRED": True,
        },
    )
    import django

    django.setup()
