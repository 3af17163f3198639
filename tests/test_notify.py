"""The notification hook: who is told, what, and that nothing of it can hold up or change a run."""

import json
import socket
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from conftest import Call, Ended, LabFolder
from running import dry_run, make_lab

from scuhand_bt.cell_spec import NotifySpec
from scuhand_bt.run import notify as hook
from scuhand_bt.run.notify import Notice, Notifier, notify

NOTICE = Notice("20260101-x", "x", True, "ended", "", 1, {"in tolerance": 2, "over": 1}, "ab12", "2026-01-01T00:00:00Z")


class Receiver(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.received.append((self.path, self.headers["Content-Type"], body))  # type: ignore[attr-defined]
        if self.path == "/slow":
            self.server.go_on.wait(5)  # type: ignore[attr-defined]
        self.send_response({"/moved": 302, "/broken": 500}.get(self.path, 204))
        self.send_header("Location", "/elsewhere")
        self.end_headers()

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[Any]:
    server: Any = HTTPServer(("127.0.0.1", 0), Receiver)
    server.received, server.go_on = [], threading.Event()
    server.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server
    server.go_on.set()
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_webhook_gets_the_notice_by_post(server: Any) -> None:
    assert notify(NotifySpec(webhook=f"{server.url}/hook?room=1"), NOTICE) is None
    ((path, kind, body),) = server.received
    assert (path, kind) == ("/hook?room=1", "application/json")
    assert json.loads(body) == {
        "run": "20260101-x",
        "recipe": "x",
        "simulated": True,
        "state": "ended",
        "reason": "",
        "exit_code": 1,
        "verdicts": {"in tolerance": 2, "over": 1},
        "choices": [],
        "head": "ab12",
        "at": "2026-01-01T00:00:00Z",
    }


def test_localhost_is_this_computer_on_whichever_address_it_listens(server: Any) -> None:
    assert notify(NotifySpec(webhook=f"http://localhost:{server.server_port}/"), NOTICE) is None


def test_a_redirection_is_not_followed_and_an_error_is_told(server: Any) -> None:
    assert notify(NotifySpec(webhook=f"{server.url}/moved"), NOTICE) == (
        f"the notification webhook {server.url} answered 302"
    )
    assert [path for path, _, _ in server.received] == ["/moved"]
    assert "answered 500" in (notify(NotifySpec(webhook=f"{server.url}/broken"), NOTICE) or "")


def test_a_proxy_of_the_environment_is_not_asked(server: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    assert notify(NotifySpec(webhook=server.url), NOTICE) is None


def test_another_computer_is_called_only_if_it_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []

    def connect(address: tuple[str, int], timeout_s: float) -> None:
        called.append(address[0])
        raise ConnectionRefusedError(111, "Connection refused")

    monkeypatch.setattr(hook.socket, "create_connection", connect)
    url = "http://192.0.2.7:8080/hook"
    assert notify(NotifySpec(webhook=url), NOTICE) == (
        "the notification webhook http://192.0.2.7:8080 was not called: "
        "'192.0.2.7' is 192.0.2.7, not this computer; list the host under 'allow'"
    )
    assert called == []
    allowed = notify(NotifySpec(webhook=url, allow=("192.0.2.7",)), NOTICE)
    assert allowed == "the notification webhook http://192.0.2.7:8080 cannot be reached: Connection refused"
    assert called == ["192.0.2.7"]


def test_a_name_that_leads_elsewhere_is_not_called(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [(2, 1, 6, "", ("127.0.0.1", 80)), (2, 1, 6, "", ("192.0.2.7", 80))]
    monkeypatch.setattr(hook.socket, "getaddrinfo", lambda *args, **more: found)
    assert "'mine.example' is 192.0.2.7" in (notify(NotifySpec(webhook="http://mine.example"), NOTICE) or "")


def test_who_is_not_there_is_told_without_the_secret_of_the_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
    error = notify(NotifySpec(webhook=f"{url}/secret-token"), NOTICE)
    assert error == f"the notification webhook {url} cannot be reached: Connection refused"


def test_a_command_gets_the_notice_on_its_standard_input(tmp_path: Path) -> None:
    target = tmp_path / "told.json"
    code = "import sys; open(sys.argv[1], 'w').write(sys.stdin.read())"
    assert notify(NotifySpec(command=(sys.executable, "-c", code, str(target))), NOTICE) is None
    assert json.loads(target.read_text())["verdicts"] == {"in tolerance": 2, "over": 1}


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (("/no/such/program",), "'/no/such/program' cannot be started: No such file or directory"),
        ((sys.executable, "-c", "raise SystemExit(7)"), "ended with code 7"),
        (("x\0y",), "cannot be started: embedded null byte"),
    ],
)
def test_a_command_that_fails_is_told(command: tuple[str, ...], said: str) -> None:
    assert said in (notify(NotifySpec(command=command), NOTICE) or "")


def test_a_command_that_does_not_end_is_ended_with_all_it_has_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hook, "LONGEST_S", 1.2)
    fifo = tmp_path / "alive"
    error = notify(NotifySpec(command=("/bin/sh", "-c", f"(sleep 60; echo > {fifo}) & sleep 60")), NOTICE)
    assert error == "the notification command '/bin/sh' was ended: it had not finished after 0.2 s"


def test_whatever_takes_too_long_is_given_up(server: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hook, "LONGEST_S", 0.2)
    began = time.monotonic()
    assert notify(NotifySpec(webhook=f"{server.url}/slow"), NOTICE) is not None
    assert time.monotonic() - began < 3.0


def test_a_notifier_keeps_nobody_waiting_and_gives_its_errors_at_the_end(server: Any) -> None:
    notifier = Notifier(NotifySpec(webhook=f"{server.url}/slow"))
    notifier.tell(NOTICE)
    server.go_on.set()
    assert notifier.finish() == []
    failing = Notifier(NotifySpec(command=("/no/such/program",)))
    failing.tell(NOTICE)
    failing.tell(NOTICE)
    assert len(failing.finish()) == 2
    assert failing.finish() == []
    nobody = Notifier(None)
    nobody.tell(NOTICE)
    assert nobody.finish() == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "write either a 'command' or a 'webhook'"),
        ("{command: [mail], webhook: 'http://localhost'}", "write either a"),
        ("{command: []}", "'command' names no program"),
        ("{command: mail}", "'mail' is not accepted"),
        ("{webhook: 'ftp://localhost/x'}", "'ftp://localhost/x' is not accepted; a web address, such as"),
        ("{webhook: 'localhost:8080'}", "a web address, such as"),
        ("{webhook: 'http://me:secret@localhost'}", "without a user"),
        ("{webhook: 'http://localhost:99999'}", "is not accepted; port out of range"),
        (
            "{webhok: 'http://localhost'}",
            "unknown key 'webhok'; known: allow, command, webhook; did you mean 'webhook'?",
        ),
    ],
)
def test_what_is_wrong_with_the_hook_is_said_in_the_cells_file(lab_folder: LabFolder, text: str, said: str) -> None:
    lab_folder.replace("robot/cell.yaml", "cell: starter\n", f"cell: starter\nnotify: {text}\n")
    problems = lab_folder.problems()
    assert any(said in problem and problem.startswith("robot/cell.yaml:4:") for problem in problems), problems


def test_a_cell_may_name_a_hook(lab_folder: LabFolder) -> None:
    hook_text = "notify: {webhook: 'https://example.org/hook', allow: [example.org]}"
    lab_folder.replace("robot/cell.yaml", "cell: starter\n", f"cell: starter\n{hook_text}\n")
    spec = lab_folder.load().cell.notify
    assert spec is not None
    assert (spec.webhook, spec.allow) == ("https://example.org/hook", ("example.org",))


def test_a_run_tells_how_it_ended_with_the_head_of_its_journal(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    cell, target = lab / "robot" / "cell.yaml", tmp_path / "told.json"
    code = f"import sys; open('{target}', 'w').write(sys.stdin.read())"
    cell.write_text(f"{cell.read_text()}notify: {{command: ['{sys.executable}', '-c', \"{code}\"]}}\n")
    sample = "{id: a, source: beads, container: xrd_holder, mass: 50 mg}"
    recipe = f"recipe: short\nworkflow: scoop_and_dispense\nsamples: [{sample}]"
    ran = dry_run(tmp_path, recipe, lab=lab)
    assert ran.session.notices == []
    told = json.loads(target.read_text())
    assert (told["state"], told["recipe"], told["run"]) == ("ended", "short", ran.session.run_id)
    assert (told["simulated"], told["exit_code"]) == (True, ran.result.exit_code)
    assert sum(told["verdicts"].values()) == 1
    assert told["head"] == ran.session.journal.head


def test_the_hook_can_be_tried(lab_folder: LabFolder, command: Call, server: Any) -> None:
    def tried(notify: str) -> Ended:
        lab_folder.write("robot/cell.yaml", f"{cell}notify: {notify}\n" if notify else cell)
        return command("notify", "--lab", lab_folder.folder)

    cell = (lab_folder.folder / "robot" / "cell.yaml").read_text()
    assert tried("").returncode == 2
    assert tried(f"{{webhook: '{server.url}'}}").returncode == 0
    assert json.loads(server.received[0][2])["reason"] == "scuhand-bt notify: a trial"
    failed = tried("{command: [/no/such/program]}")
    assert failed.returncode == 1
    assert "cannot be started" in failed.stderr
