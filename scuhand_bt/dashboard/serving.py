"""The process of the dashboard: `python -m scuhand_bt.dashboard.serving FOLDER DESCRIPTOR` is a run's own."""

import asyncio
import socket
import sys
from pathlib import Path

import uvicorn

from scuhand_bt.dashboard.access import Access
from scuhand_bt.dashboard.server import dashboard

MOST_CONNECTIONS = 400
LAST_WORDS_S = 1.0
"""A page is told how the run ended before its dashboard ends."""


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


def _server(folder: Path, access: Access) -> uvicorn.Server:
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
        limit_concurrency=MOST_CONNECTIONS,
    )
    return uvicorn.Server(config)


def serve_at(listener: socket.socket, folder: Path, access: Access) -> None:
    """Serve the lab whose state is in `folder` until Ctrl-C."""
    try:
        _server(folder, access).run([listener])
    except KeyboardInterrupt:
        pass


async def _until_the_run_ends(listener: socket.socket, folder: Path, access: Access) -> None:
    """Its program holds the other end of the standard input: it is closed however that ends."""
    server, going_on = _server(folder, access), asyncio.Event()
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
