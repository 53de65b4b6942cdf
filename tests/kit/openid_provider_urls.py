"""The addresses and the claims of the provider in `openid_provider`; Django imports this module by name."""

from typing import Any

from django.contrib.auth.forms import AuthenticationForm
from django.contrib.auth.views import LoginView
from django.template import Context, Template
from django.template.response import HttpResponse
from django.urls import include, path
from oauth2_provider.oauth2_validators import OAuth2Validator

_FORM = Template('<form method="post">{% csrf_token %}{{ form }}<button>Sign in</button></form>')


class Login(LoginView):
    """The login page."""

    authentication_form = AuthenticationForm

    def render_to_response(self, context: dict[str, Any], **_: Any) -> HttpResponse:
        return HttpResponse(_FORM.render(Context({**context, "csrf_token": _token(self.request)})))


def _token(request: Any) -> str:
    from django.middleware.csrf import get_token

    return get_token(request)


class Validator(OAuth2Validator):
    """Adds name and groups to the claims, as a mapper of Keycloak does."""

    oidc_claim_scope = None

    def get_additional_claims(self, request: Any) -> dict[str, Any]:
        user = request.user
        return {
            "preferred_username": user.username,
            "email": user.email,
            "groups": list(user.groups.values_list("name", flat=True)),
        }


urlpatterns = [path("login/", Login.as_view()), path("", include("oauth2_provider.urls"))]
