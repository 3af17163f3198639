"""A twin's port: a pseudo-terminal under a lasting name, or a TCP socket.

Both can be unplugged and plugged in again, as a cable can.
"""

import contextlib
import os
import select
import socket
import tempfile
import tty
from pathlib import Path
from typing import Protocol


class Port(Protocol):
    """One end of a cable."""

    @property
    def url(self) -> str:
        """The port that a client opens."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """The data that has come in, waiting for at most `timeout_s`; b"" if there is none."""
        ...

    def write(self, data: bytes) -> None:
        """Send; data that nobody reads is lost, as on a wire."""
        ...

    def plug(self) -> None: ...

    def unplug(self) -> None: ...

    def close(self) -> None: ...


class PtyPort:
    """A pseudo-terminal. Its name is a symbolic link, which stays the same after a replug."""

    def __init__(self, link: Path | None = None) -> None:
        self._folder = None if link else tempfile.TemporaryDirectory(prefix="twin-")
        self._link = link or Path(self._folder.name if self._folder else "") / "port"
        self._ends: tuple[int, int] | None = None
        self.plug()

    @property
    def url(self) -> str:
        return str(self._link)

    def plug(self) -> None:
        """Make the terminal and its name."""
        if self._ends is not None:
            return
        master, slave = os.openpty()
        # Raw before any client opens it: else the terminal echoes, and turns CR into LF. The slave stays
        # open here, so that the master sees no error when a client closes its end.
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._ends = (master, slave)
        fresh = self._link.with_name(self._link.name + ".new")
        fresh.unlink(missing_ok=True)  # left by a process that was killed here
        fresh.symlink_to(os.ttyname(slave))
        fresh.replace(self._link)

    def unplug(self) -> None:
        """Pull the plug: a client's next read or write fails, and the name is gone."""
        if self._ends is None:
            return
        self._link.unlink(missing_ok=True)
        ends, self._ends = self._ends, None
        for end in ends:
            os.close(end)

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()
        if self._folder is not None:
            self._folder.cleanup()

    def read(self, timeout_s: float) -> bytes:
        """What a client has written."""
        if self._ends is None:
            select.select([], [], [], timeout_s)
            return b""
        master = self._ends[0]
        if not select.select([master], [], [], timeout_s)[0]:
            return b""
        with contextlib.suppress(BlockingIOError):
            return os.read(master, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Write; if nobody reads and the buffer is full, the rest is lost."""
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], data)


class SocketPort:
    """A TCP server on the loopback interface, for one client at a time."""

    def __init__(self) -> None:
        self._number = 0
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self.plug()

    @property
    def url(self) -> str:
        return f"socket://127.0.0.1:{self._number}"

    def plug(self) -> None:
        """Listen, on the same port number as before an unplug."""
        if self._listener is None:
            self._listener = socket.create_server(("127.0.0.1", self._number), backlog=1)
            self._number = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Drop the client and stop listening."""
        for end in (self._client, self._listener):
            if end is not None:
                end.close()
        self._client = self._listener = None

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()

    def read(self, timeout_s: float) -> bytes:
        """What the client has sent."""
        ends = [end for end in (self._client, self._listener) if end is not None]
        ready = select.select(ends, [], [], timeout_s)[0]
        if self._listener in ready and self._listener is not None:
            if self._client is not None:
                self._client.close()
            self._client = self._listener.accept()[0]
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        elif self._client is not None and ready:
            with contextlib.suppress(OSError):
                if data := self._client.recv(4096):
                    return data
            self._client.close()
            self._client = None
        return b""

    def write(self, data: bytes) -> None:
        """Send to the client, if there is one."""
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.sendall(data)
