"""Sign-in with an OpenID Connect provider, such as Keycloak: code flow with PKCE, state and nonce.

- `claims`: the name and the grants of a user from the claims of the provider; pure.
- `provider`: discovery, the authorization request, the exchange of the code, and the ID token.
- `identities`: which user a subject of the provider is, and sign-ins that are under way.
- `provider_sign_in`: the use cases, above the directory.
"""
