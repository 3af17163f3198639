"""Who may see the dashboard and speak to a run by it: nobody else, whatever is sent."""

import http.client
import os
import socket
import stat
from pathlib import Path
from typing import Any

import pytest
from dashboard_client import serving
from journal_bench import HEADER

from scuhand_bt.dashboard import serving as serving_module
from scuhand_bt.dashboard.access import Access, is_loopback, kept_token, new_token, user_of
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.run.control import Control, WishListener

STOP = {"wish": "stop"}
THERE = "/api/runs/one/wish"


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """A run that listens, in a lab's folder."""
    path = tmp_path / "state" / "runs" / "one.sqlite"
    path.parent.mkdir(parents=True)
    written, control = Journal(path, durable=False), Control()
    written.event(RunBegun.model_validate(HEADER))
    listener = WishListener(path, control)
    try:
        with Presence(path):
            yield path.parent.parent, control
    finally:
        listener.end()
        written.close()


def test_loopback_is_for_its_own_user_alone(run: Any) -> None:
    folder, control = run
    for user in (os.getuid() + 1, None):
        with serving(folder, user_of=lambda client, server, user=user: user) as client:
            assert client.get("/").status == client.get("/api/runs").status == client.post(THERE, STOP).status == 403
    with serving(folder, user_of=lambda client, server: 0) as client:
        assert client.get("/api/runs").status == 200
    assert not control.is_stopping


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_the_kernel_tells_whose_connection_it_is(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip(f"this computer has no {host}")
    with listener, socket.create_connection(listener.getsockname()[:2]) as near:
        client, server = near.getsockname()[:2], listener.getsockname()[:2]
        assert user_of(client, server) == os.getuid()
        assert user_of((host, 1), server) is None
    assert user_of(("testclient", 5), server) is None


def test_off_loopback_nothing_is_shown_without_the_token_and_nothing_done_without_control(run: Any) -> None:
    folder, control = run
    token = new_token(folder)
    rules: dict[str, Any] = {"token_hash": kept_token(folder), "allows_control": False}
    with serving(folder, "0.0.0.0", **rules) as client:
        for headers in ({}, {"Cookie": "scuhand_bt=wrong"}, {"Cookie": "=;="}, {"Cookie": f"other={token}"}):
            client.headers = headers
            for path in (
                "/",
                "/api/runs",
                "/api/session",
                "/static/run.js",
                "/runs/one",
                "/api/openapi.json",
                "/nowhere",
            ):
                assert client.get(path).status == 403, path
        assert client.get("/api/runs?token=wrong").status == 403
        client.headers = {"Cookie": f"scuhand_bt={token}"}
        assert client.get("/api/runs").status == 200
        assert client.get("/api/session").values["may_control"] is False
        refused = client.post(THERE, STOP)
        assert (refused.status, "--allow-control" in refused.values["detail"]) == (403, True)
    assert not control.is_stopping
    with serving(folder, "0.0.0.0", **{**rules, "allows_control": True}) as client:
        assert client.post(THERE, STOP).status == 403
        client.headers = {"Cookie": f"scuhand_bt={token}"}
        assert client.post(THERE, STOP).status == 200
    assert control.is_stopping


def test_a_token_in_the_address_goes_into_a_cookie_that_no_script_reads(run: Any) -> None:
    folder, _ = run
    token = new_token(folder)
    with serving(folder, "0.0.0.0", token_hash=kept_token(folder)) as client:
        answer = client.get(f"/runs/one?token={token}&x=1")
        evil = client.get(f"//evil.example/?token={token}")
    assert (answer.status, answer.headers["location"]) == (303, "/runs/one?x=1")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert not evil.headers.get("location", "").startswith("//")


def test_of_a_token_only_its_hash_is_kept_and_a_new_one_ends_it(tmp_path: Path) -> None:
    first = new_token(tmp_path)
    (file,) = tmp_path.iterdir()
    assert first not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert Access("0.0.0.0", 1, kept_token(tmp_path)).is_token(first)
    second = new_token(tmp_path)
    access = Access("0.0.0.0", 1, kept_token(tmp_path))
    assert (access.is_token(second), access.is_token(first)) == (True, False)
    assert not Access("127.0.0.1", 1).is_token("")


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": ""},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"X_Dashboard": ""},
        {"X_Dashboard": "guessed"},
        {"Host": "evil.example"},
        {"Host": "evil.example:1234", "Origin": "http://evil.example:1234"},
    ],
)
def test_another_page_can_ask_for_no_change(run: Any, headers: dict[str, str]) -> None:
    folder, control = run
    with serving(folder) as client:
        assert client.post(THERE, STOP, **headers).status == 403
        assert not control.is_stopping
        assert client.post(THERE, STOP).status == 200
    assert control.is_stopping


def test_a_name_that_resolves_here_is_not_the_dashboards(run: Any) -> None:
    folder, _ = run
    with serving(folder) as client:
        for host in (
            f"rebound.example:{client.port}",
            "127.0.0.1",
            f"127.0.0.1:{client.port + 1}",
            "",
            "[::1",
            "a:b:c",
        ):
            assert client.get("/api/runs", Host=host or "x").status == 403, host
        for host in (f"localhost:{client.port}", f"127.0.0.1:{client.port}", f"[::1]:{client.port}"):
            assert client.get("/api/runs", Host=host).status == 200, host


@pytest.mark.parametrize(
    "name",
    [
        "..%2f..%2fsecret",
        "..%2Fsecret",
        "%2e%2e/secret",
        "../secret",
        "..",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "one%00",
        "one.sqlite",
        "one/../../secret",
        "linked",
        "*",
        "o*e",
        "[o]ne",
        "",
    ],
)
def test_no_name_of_a_run_reaches_a_file_elsewhere(run: Any, name: str) -> None:
    folder, _ = run
    written = Journal(folder / "secret.sqlite", durable=False)
    written.event(RunBegun.model_validate({**HEADER, "recipe": "SECRET"}))
    written.close()
    (folder / "runs" / "linked.sqlite").symlink_to(folder / "secret.sqlite")
    with serving(folder) as client:
        for path in (
            f"/api/runs/{name}",
            f"/runs/{name}",
            f"/api/runs/{name}/scene",
            f"/static/{name}",
            f"/static/viewer/{name}",
        ):
            answer = client.get(path)
            assert (answer.status in (200, 404, 405), "SECRET" in answer.text, "root:" in answer.text) == (
                True,
                False,
                False,
            )
            assert answer.status != 200 or path in ("/api/runs/", "/static/viewer/") or name in ("", "..")
        assert client.get("/api/runs/one").status == 200


def test_what_a_browser_may_do_with_a_page_is_said_with_every_answer(run: Any) -> None:
    folder, _ = run
    with serving(folder) as client:
        for path in ("/", "/runs/one", "/api/runs", "/static/run.js", "/nowhere"):
            headers = client.get(path).headers
            policy = headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "script-src 'self';" in policy
            assert "frame-ancestors 'none'" in policy
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["cache-control"] == "no-store"
            assert "access-control-allow-origin" not in headers
            assert "server" not in headers


def test_too_much_at_once_is_refused(run: Any) -> None:
    folder, control = run
    with serving(folder) as client:
        assert client.post(THERE, {"wish": "stop", "name": "x" * 100_000}).status == 413
        assert client.post(THERE, {"wish": "stop", "name": "x" * 1000}).status == 422
        assert client.post(THERE, {"wish": "dance"}).status == 422
    assert not control.is_stopping


def test_callers_who_hang_up_or_say_nothing_keep_nobody_from_stopping_the_run(run: Any) -> None:
    folder, control = run
    with serving(folder) as client:
        silent = [socket.create_connection(("127.0.0.1", client.port)) for _ in range(100)]
        for number in range(1000):
            with socket.create_connection(("127.0.0.1", client.port)) as caller:
                caller.sendall((b"", b"GET / HT", b"\xff\0", b"POST /api HTTP/1.1\r\nHost: x\r\n\r\n")[number % 4])
        assert client.post(THERE, STOP).status == 200
        for caller in silent:
            caller.close()
    assert control.is_stopping


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("10.0.0.7", False),
        ("lab.example", False),
    ],
)
def test_loopback_is_this_computer_alone(host: str, own: bool) -> None:
    assert is_loopback(host) is own


def test_too_much_in_parts_is_refused_too(run: Any) -> None:
    folder, control = run
    with serving(folder) as client:
        line = http.client.HTTPConnection("127.0.0.1", client.port, timeout=10)
        own = {"Origin": client.origin, "X-Dashboard": client.access.word, "Content-Type": "application/json"}
        parts = iter([b'{"wish": "stop", "name": null, "pin": null', b" " * 100_000, b"}"])
        line.request("POST", THERE, parts, {**own, "Transfer-Encoding": "chunked"}, encode_chunked=True)
        assert line.getresponse().status == 400
        line.close()
    assert not control.is_stopping


def test_who_connects_and_asks_for_nothing_is_hung_up_on(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = run
    monkeypatch.setattr(serving_module, "SILENT_S", 0.2)
    with serving(folder) as client, socket.create_connection(("127.0.0.1", client.port), timeout=10) as line:
        line.sendall(b"GET / HTTP/1.1\r\n")
        assert line.recv(100) == b""
