"""Notifications: tells a program or a web address when a run pauses, needs a person, or has ended.

`notify:` in `robot/cell.yaml` names it (docs/unattended.md, "Who is notified"). It gets one JSON object, a `Notice`.
Failures are returned as text: sending never raises, never takes longer than `LONGEST_S`, and never changes how a run
ends.
"""

import http.client
import ipaddress
import json
import os
import signal
import socket
import ssl
import subprocess
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import urlsplit

from scuhand_bt.cell_spec import NotifySpec
from scuhand_bt.clock import wall_time

LONGEST_S = 10.0
"""Wall time that one notice may take [s]."""

NoticeState = Literal["person soon", "needs person", "paused", "stopped", "ended"]


@dataclass(frozen=True)
class Notice:
    """What is sent: which run, its state, and why."""

    run: str
    recipe: str
    simulated: bool
    state: NoticeState
    reason: str = ""
    """What a person is needed for, what the fault was, or why it ended early; empty if all went well."""
    exit_code: int | None = None
    """None while the run may go on."""
    verdicts: Mapping[str, int] = field(default_factory=dict)
    """How many samples have ended with each verdict."""
    head: str | None = None
    """The head of the journal's hash chain, once it is known."""
    at: str = field(default_factory=wall_time)
    """Wall time, ISO 8601 with its zone."""
    choices: Sequence[str] = ()
    """The answers to what is asked; `scuhand-bt answer RUN` gives one."""

    def to_json(self) -> str:
        return json.dumps({name: getattr(self, name) for name in self.__dataclass_fields__}, sort_keys=True)


class Notifier:
    """Sends notices without keeping the cell waiting. `spec` is None if nobody is to be notified."""

    def __init__(self, spec: NotifySpec | None) -> None:
        self._spec = spec
        self._sending: list[threading.Thread] = []
        self._errors: list[str] = []

    def tell(self, notice: Notice) -> None:
        """Begin to send; returns at once."""
        if self._spec is not None:
            thread = threading.Thread(target=self._send, args=(self._spec, notice), daemon=True)
            self._sending.append(thread)
            thread.start()

    def finish(self) -> list[str]:
        """Wait for notices under way; returns what went wrong since the last call."""
        for thread in self._sending:
            thread.join()
        self._sending.clear()
        errors, self._errors = self._errors, []
        return errors

    def _send(self, spec: NotifySpec, notice: Notice) -> None:
        if (error := notify(spec, notice)) is not None:
            self._errors.append(error)


def notify(spec: NotifySpec, notice: Notice) -> str | None:
    """Send one notice and wait for it, at most `LONGEST_S`; returns what went wrong, or None."""
    found: list[str | None] = [f"the notification was not done after {LONGEST_S:g} s"]

    def send() -> None:
        try:
            if spec.command is not None:
                found[0] = _run_command(spec.command, notice.to_json())
            elif spec.webhook is not None:
                found[0] = _post(spec.webhook, spec.allow, notice.to_json())
        except Exception as error:
            found[0] = f"the notification failed: {type(error).__name__}: {error}"

    # On a thread of its own, as neither name resolution nor a trickling answer has a time limit.
    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    thread.join(LONGEST_S)
    return found[0]


def _run_command(command: tuple[str, ...], text: str) -> str | None:
    name = command[0]
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # so that Ctrl-C does not reach it, and its whole process group can be killed
        )
    except (OSError, ValueError) as error:
        return f"the notification command '{name}' cannot be started: {getattr(error, 'strerror', None) or error}"
    try:
        process.communicate(text, timeout=LONGEST_S - 1.0)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return f"the notification command '{name}' was ended: it had not finished after {LONGEST_S - 1.0:g} s"
    return (
        None if process.returncode == 0 else f"the notification command '{name}' ended with code {process.returncode}"
    )


def _post(url: str, allow: tuple[str, ...], text: str) -> str | None:
    """POST to the very address that was checked, so that no second look-up of the name can lead elsewhere.

    `http.client` follows no redirection and uses no proxy, so nothing else is reached by a detour.
    """
    parts = urlsplit(url)
    host, is_https = parts.hostname or "", parts.scheme == "https"
    port = parts.port or (443 if is_https else 80)
    where = f"the notification webhook {parts.scheme}://{parts.netloc}"
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError as error:
        return f"{where} cannot be found: {error.strerror or error}"
    addresses = list(dict.fromkeys(str(one[4][0]) for one in found))
    for address in addresses:
        if host not in allow and not ipaddress.ip_address(address).is_loopback:
            return f"{where} was not called: '{host}' is {address}, not this computer; list the host under 'allow'"
    connection = http.client.HTTPConnection(host, port, timeout=LONGEST_S)
    try:
        connection.sock = _connected(addresses, port)
        if is_https:
            connection.sock = ssl.create_default_context().wrap_socket(connection.sock, server_hostname=host)
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        connection.request("POST", target, text.encode(), {"Content-Type": "application/json"})
        status = connection.getresponse().status
    except (OSError, http.client.HTTPException) as error:
        return f"{where} cannot be reached: {getattr(error, 'strerror', None) or error or type(error).__name__}"
    finally:
        connection.close()
    return None if 200 <= status < 300 else f"{where} answered {status}"


def _connected(addresses: Sequence[str], port: int) -> socket.socket:
    """A connection to the first address that accepts it; raises the last one's OSError if none does."""
    for address in addresses[:-1]:
        with suppress(OSError):
            return socket.create_connection((address, port), LONGEST_S)
    return socket.create_connection((addresses[-1], port), LONGEST_S)
