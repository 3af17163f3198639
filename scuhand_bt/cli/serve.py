"""The command that shows the lab's runs on a page, and the dashboard that a run brings along."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, err, out

PORT = 8765
LONGEST_END_S = 5.0
"""A run's dashboard has this time to end with it."""


@app.command()
def serve(
    host: Annotated[
        str, typer.Option(help="The address to listen at; any other than this computer's own needs a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port; 0 takes a free one.")] = PORT,
    allow_control: Annotated[
        bool, typer.Option("--allow-control", help="Let whoever has the token pause, stop and answer, not only look.")
    ] = False,
    fresh_token: Annotated[
        bool, typer.Option("--new-token", help="Make a new token; the old one no longer works.")
    ] = False,
    lab: LabOption = None,
) -> None:
    """Show running and past runs of the lab on a web page until Ctrl-C, without affecting them (extra `serve`)."""
    from scuhand_bt.api import find_state
    from scuhand_bt.dashboard import Access, is_loopback, kept_token, new_token

    folder = find_state(lab)
    is_own, shown = is_loopback(host), ""
    try:
        from scuhand_bt.dashboard import listen_at, serve_at

        listener = listen_at(host, port)
        if not is_own and (fresh_token or kept_token(folder) is None):
            shown = new_token(folder)
    except ModuleNotFoundError as error:
        raise typer.BadParameter(f"a dashboard needs {error.name}: pip install 'scuhand-bt[serve]'") from None
    except OSError as error:
        raise typer.BadParameter(f"cannot listen at {host}:{port}: {error.strerror or error}") from None
    port = listener.getsockname()[1]
    access = Access(host, port, None if is_own else kept_token(folder), is_own or allow_control)
    name = f"[{host}]" if ":" in host else host
    out.print(Text(f"The lab's runs: http://{name}:{port}/" + (f"?token={shown}" if shown else "")), soft_wrap=True)
    if shown:
        err.print(Text("This token is shown once, and only its hash is kept; `--new-token` makes another."))
    elif not is_own:
        err.print(Text("Open it with the token that was shown when it was made; `--new-token` makes another."))
    if not is_own:
        what = "look, pause, stop and answer" if allow_control else "look"
        err.print(
            Text(f"Whoever has the token can {what}. Nothing is encrypted: use it only in a network that you trust.")
        )
    with listener:
        serve_at(listener, folder, access)


def require_dashboard() -> None:
    """Raises BadParameter where there is none to bring along."""
    try:
        from scuhand_bt.dashboard import serve_at  # noqa: F401
    except ModuleNotFoundError as error:
        problem = f"a dashboard needs {error.name}: pip install 'scuhand-bt[serve]'"
        raise typer.BadParameter(problem, param_hint="--dashboard") from None


@contextmanager
def dashboard_beside(journal: Path) -> Iterator[str]:
    """A dashboard in a process of its own that ends with this one, however that ends; gives the address of the run."""
    from scuhand_bt.dashboard import listen_at

    with listen_at("127.0.0.1", 0) as listener:
        process = subprocess.Popen(
            [sys.executable, "-m", "scuhand_bt.dashboard.serving", str(journal.parent.parent), str(listener.fileno())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[listener.fileno()],
            start_new_session=True,  # Ctrl-C is the run's
        )
        port = listener.getsockname()[1]
    assert process.stdin is not None
    try:
        yield f"http://127.0.0.1:{port}/runs/{quote(journal.stem)}"
    finally:
        process.stdin.close()
        try:
            process.wait(LONGEST_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
