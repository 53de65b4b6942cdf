"""`/docs`: the routes of a service in Swagger UI, whose files the service has itself.

A cell often has no way to the internet, and a page that loads scripts of another host would run what that
host sends. So nothing here names another host: neither the page, nor Swagger UI, which otherwise has a
validator of documents there. A content security policy forbids other hosts, and scripts within the page.
"""

from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Final

from fastapi import FastAPI
from fastapi.responses import FileResponse, HTMLResponse, Response

ASSETS: Final = {
    "/docs/swagger-ui-bundle.js": "text/javascript",
    "/docs/swagger-ui.css": "text/css",
}
START: Final = "/docs/start.js"
DOCS_PATHS: Final = frozenset({"/docs", START, *ASSETS})

SECURITY_POLICY: Final = (
    "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_PAGE: Final = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="docs/swagger-ui.css">
</head>
<body>
<div id="docs"></div>
<script src="docs/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"""
_START: Final = """\
SwaggerUIBundle({ url: "openapi.json", dom_id: "#docs", deepLinking: true, validatorUrl: null });
"""


def add_docs(app: FastAPI) -> None:
    """Add `/docs` to `app`. Its addresses are relative, so that a proxy may put the service under a path."""
    page = _PAGE.format(title=escape(app.title))

    @app.get("/docs", include_in_schema=False)
    async def docs() -> Response:
        return HTMLResponse(page, headers={"Content-Security-Policy": SECURITY_POLICY})

    @app.get(START, include_in_schema=False)
    async def start() -> Response:
        return Response(_START, media_type="text/javascript")

    for path, media_type in ASSETS.items():
        _add_asset(app, path, media_type)


def _add_asset(app: FastAPI, path: str, media_type: str) -> None:
    @app.get(path, include_in_schema=False)
    async def asset() -> Response:
        return FileResponse(_folder() / Path(path).name, media_type=media_type)


def _folder() -> Path:
    return Path(str(files("fastapi_offline"))) / "static"
