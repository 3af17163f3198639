"""Ports for what must be told its port before it listens."""

import itertools
import os
import socket
from contextlib import ExitStack

# Above those that only root may open, below those that systems give to outgoing connections (Linux: from 32768 on;
# IANA: from 49152), so that no connection of another test takes one between this look and the listening.
_FIRST, _BEHIND = 10_000, 32_000
_starts = itertools.count(os.getpid() * 16)  # two processes that look at the same time start apart


def unused_port(together: int = 1) -> int:
    """The first of so many neighbouring ports of 127.0.0.1 at which nothing listens."""
    while True:
        first = _FIRST + next(_starts) * together % (_BEHIND - _FIRST - together)
        with ExitStack() as held:
            try:
                for port in range(first, first + together):
                    held.enter_context(socket.socket()).bind(("127.0.0.1", port))
            except OSError:
                continue
        return first
