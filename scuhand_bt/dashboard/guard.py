"""What stands before every page: the rules of access, sizes, and what a browser is told to allow."""

from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from scuhand_bt.dashboard.access import COOKIE, Access

LARGEST = 16_384
"""Bytes that anybody can send at once."""
HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        b"base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


class Guard:
    """An application behind its rules."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is allowed."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # there is no web socket here
            return
        refused = self._refused(scope)
        if refused is not None:
            await refused(scope, receive, _with_headers(send))
            return
        await self._app(scope, _no_more_than(receive), _with_headers(send))

    def _refused(self, scope: Scope) -> Response | None:
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = next((value for name, value in query if name == "token"), None)
        changes = scope["method"] not in ("GET", "HEAD", "OPTIONS")
        why = self._access.why_not(
            headers, given or _kept(headers), scope.get("client"), scope.get("server"), changes=changes
        )
        if why is not None:
            return JSONResponse({"detail": why}, status_code=403)
        length = headers.get("content-length", "0").strip()
        if length.isdecimal() and int(length[:20]) > LARGEST:
            return JSONResponse({"detail": f"that is more than {LARGEST} bytes"}, status_code=413)
        if given is None or changes or not self._access.is_token(given):
            return None
        # Out of the address, where others may read it, and into a cookie that no script reads.
        rest = urlencode([(name, value) for name, value in query if name != "token"])
        there = "/" + scope["path"].lstrip("/") + (f"?{rest}" if rest else "")
        answer = RedirectResponse(there, status_code=303)
        answer.set_cookie(COOKIE, given, httponly=True, samesite="strict", max_age=30 * 24 * 3600)
        return answer


def _kept(headers: dict[str, str]) -> str:
    """The token that a browser has kept."""
    try:
        kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return kept.value if kept is not None else ""


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *HEADERS]
        await send(message)

    return sending


def _no_more_than(receive: Receive) -> Receive:
    heard = 0

    async def receiving() -> Message:
        nonlocal heard
        message = await receive()
        heard += len(message.get("body", b""))
        return message if heard <= LARGEST else {"type": "http.disconnect"}

    return receiving
