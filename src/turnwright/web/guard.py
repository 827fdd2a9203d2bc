"""Access control: host names, origins, the token, request sizes and security headers.

A page of another site, open in the same browser, can reach this server. A request must therefore name this server as
its host (against DNS rebinding), and a request that changes anything must come from a page of this server (against
cross-site request forgery).
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

__all__ = ["BODY_BYTES", "CLOSE_CONNECTION", "UPLOAD_BYTES", "Guard", "require_token"]

UPLOAD_BYTES = 2 * 2**30
"""Size limit of a measured file. [byte]"""

ROUTES_WITH_TEXT = {"/api/job/write", "/api/job/bundle", "/api/runs"}
"""Routes that receive a job both as data and as text."""

MIN_TOKEN_LENGTH = 16
"""Shortest token; a shorter one can be guessed."""

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
CLOSE_CONNECTION = {"Connection": "close"}
"""Header of an answer that ends the connection instead of reading an unbounded request."""

MAX_DRAINED_LIMITS = 4
"""Multiple of the size limit up to which a request is read to its end, so that a browser can read the answer."""

SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}


def require_token(token: str | None) -> None:
    """Raise unless a token is ``None`` or long enough."""
    if token is not None and not re.fullmatch(rf"[!-~]{{{MIN_TOKEN_LENGTH},200}}", token):
        raise InputError(
            f"--token must have {MIN_TOKEN_LENGTH} to 200 printable ASCII characters without spaces, got {len(token)}"
        )


class Guard:
    """ASGI middleware that refuses requests of unauthorised clients; parameters as of `turnwright.web.create_app`."""

    def __init__(self, app: ASGIApp, *, token: str | None = None, origin: str | None = None) -> None:
        require_token(token)
        self.app, self.token = app, token
        self.named = urlsplit(origin).hostname if origin else None
        self.secure = bool(origin) and urlsplit(origin).scheme == "https"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        # Browsers and proxies write the host differently; only its name is compared.
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            status, sentence = refusal
            headers_sent = HEADERS | (
                CLOSE_CONNECTION if status == TOO_LARGE and not _is_bounded(scope, headers) else {}
            )
            await JSONResponse({"detail": sentence}, status, headers=headers_sent)(scope, receive, send)
            return
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        if self.token is not None and scope["method"] == "GET" and any(name == "token" for name, _ in query):
            # Set the cookie and remove the token from the address.
            remaining = urlencode([(name, value) for name, value in query if name != "token"])
            answer = RedirectResponse(
                f"{_plain(scope['path'])}{'?' if remaining else ''}{remaining}", 303, headers=HEADERS
            )
            answer.set_cookie(COOKIE, self.token, max_age=YEAR_S, httponly=True, samesite="strict", secure=self.secure)
            await answer(scope, receive, send)
            return
        await self.app(scope, _counted(scope, receive), _with_headers(send))

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Return status and message of a refused request, else ``None``."""
        hosts = headers.getlist("host")
        name = _host_name(hosts[0]) if len(hosts) == 1 else None
        if name is None or not self._is_mine(name):
            return 421, "the host name is not that of this server: open the address printed by turnwright serve"
        if scope["method"] not in SAFE_METHODS or scope["path"].startswith("/api"):
            site = headers.get("sec-fetch-site")
            origins = headers.getlist("origin")
            foreign = any(_netloc(origin) != hosts[0].casefold() for origin in origins)
            if foreign or site not in (None, "same-origin", "none"):
                return 403, "the request comes from a page of another origin"
        if self.token is not None and not self._knows(scope, headers):
            return 401, "the token is missing or wrong: open the address printed by turnwright serve"
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
        try:  # any IP address is accepted with the token; a host name could be a rebound foreign name
            ipaddress.ip_address(name)
        except ValueError:
            hostname = socket.gethostname().casefold()
            return "." not in name or name.endswith(".local") or name == hostname  # local network names
        return True

    def _knows(self, scope: Scope, headers: Headers) -> bool:
        token = (self.token or "").encode()
        candidates = [value for name, value in parse_qsl(scope["query_string"].decode("latin-1")) if name == "token"]
        kind, _, value = headers.get("authorization", "").partition(" ")
        if kind.casefold() == "bearer":
            candidates.append(value.strip())
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        if cookie is not None:
            candidates.append(cookie.value)
        return any(hmac.compare_digest(one.encode("utf-8", "replace"), token) for one in candidates)


def _host_name(host: str) -> str | None:
    """Return the name in a Host header, without its port."""
    match = re.fullmatch(r"(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9.-]{1,253})(?::[0-9]{1,5})?", host)
    return match.group(1).strip("[]").casefold() if match else None


def _netloc(origin: str) -> str | None:
    """Return host and port of an Origin header; ``None`` if it has none, such as "null"."""
    match = re.fullmatch(r"https?://([^/?#@\s]+)", origin)
    return match.group(1).casefold() if match else None


def _plain(path: str) -> str:
    """Return a path on this host; a leading double slash would name another one."""
    return "/" + path.replace("\\", "/").lstrip("/")


def _limit(scope: Scope) -> int:
    files = dict.fromkeys(("/api/files", "/api/files/archive", "/api/measurements/show"), FILE_BYTES)
    limits = {"/api/measurements": UPLOAD_BYTES, **files}
    return limits.get(scope["path"], 2 * BODY_BYTES if scope["path"] in ROUTES_WITH_TEXT else BODY_BYTES)


def _is_bounded(scope: Scope, headers: Headers) -> bool:
    length = headers.get("content-length", "")
    return re.fullmatch("[0-9]{1,15}", length) is not None and int(length) <= MAX_DRAINED_LIMITS * _limit(scope)


def _too_large(limit: int) -> str:
    size = f"{limit // 2**30} GiB" if limit >= 2**30 else f"{limit // 2**20} MiB"
    return f"the request must be at most {size}"


def _counted(scope: Scope, receive: Receive) -> Receive:
    """Enforce the size limit on the received bytes; a chunked request does not state its length."""
    limit, seen = _limit(scope), 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > limit:
            raise HTTPException(TOO_LARGE, _too_large(limit), CLOSE_CONNECTION)
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
