"""Who may ask what: addresses, origins, the token, the size of what is sent, and what a browser may load.

A page of somebody else's, open in the same browser, reaches this server too. So a request must name this server as its
host (or a foreign name could be pointed here), and one that changes anything must come from a page of this server.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import socket
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, RedirectResponse

from turnwright.errors import InputError
from turnwright.web.address import is_loopback
from turnwright.web.limits import BODY_BYTES, FILE_BYTES

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["BODY_BYTES", "HANG_UP", "UPLOAD_BYTES", "Guard", "require_token"]

UPLOAD_BYTES = 2 * 2**30
"""Of a measured file."""

WITH_TEXT = {"/api/job/write", "/api/job/bundle", "/api/runs"}
"""Where a job comes as data, and with it the text that it was before."""

TOKEN_LETTERS = 16
"""A shorter token is guessed."""

COOKIE = "turnwright"
YEAR_S = 365 * 24 * 3600

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

TOO_LARGE = 413
HANG_UP = {"Connection": "close"}
"""Goes along with that where the rest of what is too large has no bound."""

DISCARDED = 4
"""Limits that a request may be long and still be read to its end: closed while it sends, a browser reads no answer."""

HARMLESS = {"GET", "HEAD", "OPTIONS"}


def require_token(token: str | None) -> None:
    """Raise unless a token is one that nobody guesses, or none."""
    if token is not None and not re.fullmatch(rf"[!-~]{{{TOKEN_LETTERS},200}}", token):
        raise InputError(
            f"the token has {len(token)} characters, it must be {TOKEN_LETTERS} to 200 letters, digits and marks "
            "without spaces: take a longer one"
        )


class Guard:
    """Stands before everything else.

    Parameters
    ----------
    app
        What is guarded.
    token
        What whoever asks must know; ``None`` where only this computer reaches the server.
    origin
        The address of the page, such as "https://lathe.example", where it is not that of this computer.
    """

    def __init__(self, app: ASGIApp, *, token: str | None = None, origin: str | None = None) -> None:
        require_token(token)
        self.app, self.token = app, token
        self.named = urlsplit(origin).hostname if origin else None
        self.secure = bool(origin) and urlsplit(origin).scheme == "https"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it in a sentence."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        # A browser under Windows or a proxy writes the host its own way; only its name counts.
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            status, sentence = refusal
            headers_sent = HEADERS | (HANG_UP if status == TOO_LARGE and not _is_bounded(scope, headers) else {})
            await JSONResponse({"detail": sentence}, status, headers=headers_sent)(scope, receive, send)
            return
        given = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        if self.token is not None and scope["method"] == "GET" and any(name == "token" for name, _ in given):
            # The address that was given out logs a browser in once, and does not stay in its bar.
            rest = urlencode([(name, value) for name, value in given if name != "token"])
            answer = RedirectResponse(f"{_plain(scope['path'])}{'?' if rest else ''}{rest}", 303, headers=HEADERS)
            answer.set_cookie(COOKIE, self.token, max_age=YEAR_S, httponly=True, samesite="strict", secure=self.secure)
            await answer(scope, receive, send)
            return
        await self.app(scope, _counted(scope, receive), _with_headers(send))

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Return the status and the sentence of a request that is refused, else ``None``."""
        hosts = headers.getlist("host")
        name = _host_name(hosts[0]) if len(hosts) == 1 else None
        if name is None or not self._is_mine(name):
            return 421, "the request names another host than this server: open the address that turnwright serve said"
        if scope["method"] not in HARMLESS or scope["path"].startswith("/api"):
            site = headers.get("sec-fetch-site")
            origins = headers.getlist("origin")
            foreign = any(_netloc(origin) != hosts[0].casefold() for origin in origins)
            if foreign or site not in (None, "same-origin", "none"):
                return 403, "the request comes from a page of another origin: use the page of this server"
        if self.token is not None and not self._knows(scope, headers):
            return 401, "the token is missing or wrong: open the address with ?token= that turnwright serve said"
        length = headers.get("content-length")
        limit = _limit(scope)
        if length is not None and (not re.fullmatch("[0-9]{1,15}", length) or int(length) > limit):
            return TOO_LARGE, _too_large(limit)
        return None

    def _is_mine(self, name: str) -> bool:
        if is_loopback(name) or (self.named is not None and name == self.named.casefold()):
            return True
        if self.token is None:
            return False
        try:  # who knows the token may come by any number; a name could belong to somebody else
            ipaddress.ip_address(name)
        except ValueError:
            own = socket.gethostname().casefold()
            return "." not in name or name.endswith(".local") or name == own  # of the workshop's own net
        return True

    def _knows(self, scope: Scope, headers: Headers) -> bool:
        wanted = (self.token or "").encode()
        given = [value for name, value in parse_qsl(scope["query_string"].decode("latin-1")) if name == "token"]
        kind, _, value = headers.get("authorization", "").partition(" ")
        if kind.casefold() == "bearer":
            given.append(value.strip())
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        if cookie is not None:
            given.append(cookie.value)
        return any(hmac.compare_digest(one.encode("utf-8", "replace"), wanted) for one in given)


def _host_name(host: str) -> str | None:
    """Return the name in a Host header, without its port."""
    match = re.fullmatch(r"(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9.-]{1,253})(?::[0-9]{1,5})?", host)
    return match.group(1).strip("[]").casefold() if match else None


def _netloc(origin: str) -> str | None:
    """Return host and port of an Origin header; ``None`` for what is none, such as "null"."""
    match = re.fullmatch(r"https?://([^/?#@\s]+)", origin)
    return match.group(1).casefold() if match else None


def _plain(path: str) -> str:
    """Return a path that leads nowhere else: two slashes would begin with another host."""
    return "/" + path.replace("\\", "/").lstrip("/")


def _limit(scope: Scope) -> int:
    files = dict.fromkeys(("/api/files", "/api/files/archive", "/api/measurements/show"), FILE_BYTES)
    limits = {"/api/measurements": UPLOAD_BYTES, **files}
    return limits.get(scope["path"], 2 * BODY_BYTES if scope["path"] in WITH_TEXT else BODY_BYTES)


def _is_bounded(scope: Scope, headers: Headers) -> bool:
    length = headers.get("content-length", "")
    return re.fullmatch("[0-9]{1,15}", length) is not None and int(length) <= DISCARDED * _limit(scope)


def _too_large(limit: int) -> str:
    size = f"{limit // 2**30} GiB" if limit >= 2**30 else f"{limit // 2**20} MiB"
    return f"the request is larger than {size}, the limit: send less"


def _counted(scope: Scope, receive: Receive) -> Receive:
    """Count what arrives, for a request in chunks does not say its length."""
    limit, seen = _limit(scope), 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > limit:
            raise HTTPException(TOO_LARGE, _too_large(limit), HANG_UP)
        return message

    return counted


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("Cache-Control", "no-store")
        await send(message)

    return sent
