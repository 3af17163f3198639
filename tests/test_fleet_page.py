"""The queue is set up and used as docs/fleet.md says."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import REPOSITORY
from fleet_bench import PATIENCE_S
from running import make_lab

from harness.postgres import server, tools

PAGE = (REPOSITORY / "docs" / "fleet.md").read_text(encoding="utf-8")
ETC = "/etc/postgresql/15/main"
PASSWORD = "correct horse"


@pytest.mark.slow
@pytest.mark.skipif(tools() is None, reason="no PostgreSQL here: apt install postgresql")
def test_the_queue_is_set_up_and_used_as_the_page_says(tmp_path: Path) -> None:
    """Server and clients with the page's own commands and files; only places, the port and the password differ."""
    setup, use = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
    settings, access, service, password, _ = re.findall(r"^```ini\n(.*?)^```", PAGE, re.M | re.S)
    with server() as made:
        data = made.folder / "data"
        for line in setup.splitlines()[1:]:
            words = shlex.split(line.replace(ETC, str(data)))
            assert words[:3] == ["sudo", "-u", "postgres"]
            made.run(*words[3:], answers=f"{PASSWORD}\n{PASSWORD}\n")
        with (data / "postgresql.conf").open("a") as file:
            file.write(settings.replace(ETC, str(data)).replace("'*'", "'127.0.0.1'"))
        (data / "pg_hba.conf").write_text(access)
        made.restart()
        home = tmp_path / "home"
        (home / ".postgresql").mkdir(parents=True)
        (home / ".postgresql" / "root.crt").write_bytes((data / "queue.crt").read_bytes())
        (home / ".pg_service.conf").write_text(service)
        (home / ".pgpass").write_text(password.replace("5432", str(made.port)).replace("the password", PASSWORD))
        (home / ".pgpass").chmod(0o600)
        lab = make_lab(tmp_path / "lab")
        shutil.copytree(REPOSITORY / "recipes", lab / "recipes")
        here = {**os.environ, "HOME": str(home), "PGHOSTADDR": "127.0.0.1", "PGPORT": str(made.port)}
        (variable, station, *commands) = (shlex.split(line)[1:] for line in use.splitlines())
        environment = {**here, **dict([variable[0].split("=")])}

        def command(*words: str) -> "subprocess.CompletedProcess[str]":
            program = [sys.executable, "-m", "scuhand_bt", *words]
            return subprocess.run(program, env=environment, cwd=lab, capture_output=True, text=True)

        said = tmp_path / "said.txt"
        with said.open("w") as output:
            works = subprocess.Popen(
                [sys.executable, "-m", "scuhand_bt", *station], env=environment, cwd=lab, stdout=output, stderr=output
            )
        try:
            await_line(said, "waits for a job")
            submit, queue, fleet = commands
            assert command(*submit).stdout == "job 1: recipes/xrd_holders.yaml at trial\n"
            await_line(said, "job 1: succeeded: done (8 in tolerance)")
            assert "succeeded" in command(*queue).stdout
            assert "trial" in command(*fleet).stdout
            plain = command("queue", "--database", "service=scuhand sslmode=disable")
            assert (plain.returncode, "no encryption" in plain.stderr) == (2, True)
            (home / ".pgpass").unlink()
            assert "password" in command("queue").stderr
        finally:
            works.terminate()
            assert works.wait() == 0


def await_line(file: Path, line: str) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while line not in file.read_text().splitlines():
        assert time.monotonic() < until_s, file.read_text()
        time.sleep(0.1)
