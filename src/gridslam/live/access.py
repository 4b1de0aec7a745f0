"""Access to the page: its token, and pages of other sites."""

from __future__ import annotations

import secrets

from starlette.requests import HTTPConnection


def is_authorized(connection: HTTPConnection, token: str | None) -> bool:
    """Return whether a request has the token, if one is needed."""
    given = connection.query_params.get("token", "")
    return token is None or secrets.compare_digest(given.encode(), token.encode())


def is_foreign(connection: HTTPConnection) -> bool:
    """Return whether a request comes from another site's page."""
    origin = connection.headers.get("origin")
    return origin is not None and origin.partition("://")[2] != connection.headers.get("host")
