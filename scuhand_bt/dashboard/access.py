"""Who may see the dashboard, and who may speak to a run by it.

On this computer alone: its own user (and root), whom the kernel tells at the other end of a loopback connection.
From elsewhere: whoever has the token, shown once and kept as its SHA-256; and only to look, unless control was allowed.
What changes something has to come from the dashboard's own page: by its Origin, and by a word that only this page has.
"""

import hashlib
import hmac
import ipaddress
import os
import secrets
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

TOKEN_FILE = "dashboard.token"
COOKIE = "scuhand_bt"
_TCP, _TCP6 = Path("/proc/net/tcp"), Path("/proc/net/tcp6")

Address = tuple[str, int]


def is_loopback(host: str) -> bool:
    """Whether nobody but this computer reaches this address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token(folder: Path) -> str:
    """A token for this lab, in place of the one before; only its hash is kept. Raises OSError."""
    token, path = secrets.token_urlsafe(24), folder / TOKEN_FILE
    folder.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    path.touch(0o600, exist_ok=False)
    path.write_text(_hash(token), encoding="ascii")
    return token


def kept_token(folder: Path) -> str | None:
    """The hash of this lab's token, if it has one."""
    try:
        return (folder / TOKEN_FILE).read_text(encoding="ascii").strip() or None
    except (OSError, UnicodeDecodeError):
        return None


def user_of(client: Address, server: Address) -> int | None:
    """Whose connection over loopback this is, as the kernel has it; None where that cannot be told."""
    try:
        near, far = _in_hex(client), _in_hex(server)
        table = _TCP if ipaddress.ip_address(client[0]).version == 4 else _TCP6
        for line in table.read_text(encoding="ascii").splitlines()[1:]:
            _, local, remote, _, _, _, _, user, *_ = line.split()
            if (local, remote) == (near, far):
                return int(user)
    except (OSError, ValueError):
        pass
    return None


def _in_hex(address: Address) -> str:
    """As the kernel's tables write it: the words of the address in the machine's own order."""
    packed = ipaddress.ip_address(address[0]).packed
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{word:08X}" for word in words) + f":{address[1]:04X}"


@dataclass(frozen=True)
class Access:
    """The rules of one dashboard. `token_hash`: None on loopback alone."""

    host: str
    port: int
    token_hash: str | None = None
    allows_control: bool = True
    user_of: Callable[[Address, Address], int | None] = user_of
    word: str = field(default_factory=lambda: secrets.token_urlsafe(18))
    """What only its own page knows: nobody else's page can ask for a change."""

    def is_token(self, token: str) -> bool:
        return self.token_hash is not None and hmac.compare_digest(_hash(token), self.token_hash)

    def why_not(
        self, headers: Mapping[str, str], token: str, client: Address | None, server: Address | None, *, changes: bool
    ) -> str | None:
        """Why a request is refused; None where it is not. `changes`: it asks for more than a look."""
        if not self._is_own_host(headers.get("host", "")):
            return "this is not the address of the dashboard"
        if self.token_hash is not None:
            if not self.is_token(token):
                return "the dashboard asks for its token: open it as http://…/?token=…"
        elif client is None or server is None or self.user_of(client, server) not in (os.getuid(), 0):
            return "this dashboard belongs to another user"
        if not changes:
            return None
        if not self.allows_control:
            return "this dashboard only shows runs: start it with `--allow-control` to control them"
        if headers.get("origin") != f"http://{headers['host']}":
            return "this request came from another page"
        if not hmac.compare_digest(headers.get("x-dashboard", ""), self.word):
            return "this page is from an earlier dashboard: reload it"
        return None

    def _is_own_host(self, given: str) -> bool:
        """A page of elsewhere may have its own name resolve to this computer: only addresses are the dashboard's."""
        host, _, port = given.rpartition(":") if given.rpartition(":")[2].isdecimal() else (given, "", "80")
        if port != str(self.port):
            return False
        host = host.strip("[]").lower()
        if is_loopback(host) or host == self.host.lower():
            return True
        try:
            return self.token_hash is not None and bool(ipaddress.ip_address(host))
        except ValueError:
            return False


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()
