"""The process of the dashboard: `python -m scuhand_bt.dashboard.serving FOLDER DESCRIPTOR` is a run's own."""

import asyncio
import socket
import sys
from contextlib import suppress
from pathlib import Path

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from scuhand_bt.dashboard.access import Access
from scuhand_bt.dashboard.server import dashboard

SILENT_S = 5.0
"""Who connects and asks for nothing is hung up on after this time."""
LAST_WORDS_S = 1.0
"""A page is told how the run ended before its dashboard ends."""


class _Listening(H11Protocol):
    """A connection on which something has to be asked for in time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Give the caller some time."""
        super().connection_made(transport)
        self.loop.call_later(SILENT_S, self._hang_up)

    def _hang_up(self) -> None:
        if self.cycle is None:
            self.transport.close()


def listen_at(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(128)
    except OSError:
        listener.close()
        raise
    listener.set_inheritable(True)
    return listener


def server_of(folder: Path, access: Access) -> uvicorn.Server:
    """The server of the lab whose state is in `folder`, to be run on a socket."""
    config = uvicorn.Config(
        dashboard(folder, access),
        log_level="critical",
        access_log=False,
        lifespan="off",
        ws="none",
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=1,
        http=_Listening,
    )
    return uvicorn.Server(config)


def serve_at(listener: socket.socket, folder: Path, access: Access) -> None:
    """Serve the lab whose state is in `folder` until Ctrl-C."""
    with suppress(KeyboardInterrupt):
        server_of(folder, access).run([listener])


async def _until_the_run_ends(listener: socket.socket, folder: Path, access: Access) -> None:
    """Its program holds the other end of the standard input: it is closed however that ends."""
    server, going_on = server_of(folder, access), asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin, going_on.set)
    serving = asyncio.create_task(server.serve([listener]))
    await asyncio.wait([serving, asyncio.create_task(going_on.wait())], return_when=asyncio.FIRST_COMPLETED)
    await asyncio.sleep(LAST_WORDS_S)
    server.should_exit = True
    await serving


def main(arguments: list[str]) -> None:
    """Serve at a socket that was inherited, as long as the run's program lives."""
    listener = socket.socket(fileno=int(arguments[1]))
    host, port = listener.getsockname()[:2]
    asyncio.run(_until_the_run_ends(listener, Path(arguments[0]), Access(host, port)))


if __name__ == "__main__":
    main(sys.argv[1:])
