"""A PostgreSQL server of one's own, from Debian's package, on this computer's loopback and gone afterwards."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from harness.ports import unused_port

OWNER = "postgres"
"""Who runs it where root asks: it does not run as root. Debian's package makes this user."""


def tools() -> Path | None:
    """Where `initdb` and `pg_ctl` are, the newest ones; None where there are none."""
    if (found := shutil.which("initdb")) is not None:
        return Path(found).parent
    return max(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name), default=None)


@dataclass(frozen=True)
class Server:
    """One that runs; its superuser is `postgres`."""

    folder: Path
    port: int

    def address(self, name: str = "postgres", user: str = OWNER) -> str:
        """A database of it, as libpq names it."""
        return f"host=127.0.0.1 port={self.port} dbname={name} user={user}"

    def restart(self, mode: str = "fast") -> None:
        """End it, connections and all, and start it again; `immediate` is as a power cut."""
        self.stop(mode)
        self.start()

    def start(self) -> None:
        self.run("pg_ctl", "start", "--wait", "-D", "data", "-l", "log", "-o", f"-p {self.port} -k {self.folder}")

    def stop(self, mode: str = "fast") -> None:
        self.run("pg_ctl", "stop", "--wait", "-D", "data", "-m", mode)

    def run(self, *command: str, answers: str = "") -> None:
        """A command as the server's owner, who has no terminal: what it asks is answered by `answers`."""
        path = f"{tools()}{os.pathsep}{os.environ['PATH']}"
        subprocess.run(
            command,
            cwd=self.folder,
            user=OWNER if os.getuid() == 0 else None,
            env={**os.environ, "PATH": path, "PGHOST": str(self.folder), "PGPORT": str(self.port), "PGUSER": OWNER},
            check=True,
            stdout=subprocess.DEVNULL,
            input=answers.encode(),
            start_new_session=True,
        )


@contextmanager
def server() -> Iterator[Server]:
    """A new one, that trusts this computer."""
    made = Server(Path(tempfile.mkdtemp(prefix="scuhand-postgres-")), unused_port())
    try:
        if os.getuid() == 0:
            os.chown(made.folder, pwd.getpwnam(OWNER).pw_uid, -1)
        made.run("initdb", "-D", "data", "-U", OWNER, "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync")
        with (made.folder / "data" / "postgresql.conf").open("a", encoding="utf-8") as settings:
            settings.write("listen_addresses = '127.0.0.1'\n")
        made.start()
        try:
            yield made
        finally:
            made.stop("immediate")
    finally:
        shutil.rmtree(made.folder)
