"""A dashboard that serves a folder on loopback, for tests, and what a page would ask of it."""

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scuhand_bt.dashboard.access import Access
from scuhand_bt.dashboard.serving import listen_at, server_of


@dataclass
class Asked:
    """What was answered."""

    status: int
    headers: dict[str, str]
    text: str

    @property
    def values(self) -> Any:
        return json.loads(self.text)


@dataclass
class Client:
    """Asks a dashboard, as its own page does unless told otherwise."""

    port: int
    access: Access
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def get(self, path: str, **headers: str) -> Asked:
        return self._ask("GET", path, None, headers)

    def post(self, path: str, body: object, **headers: str) -> Asked:
        own = {"Origin": self.origin, "X-Dashboard": self.access.word, "Content-Type": "application/json"}
        return self._ask("POST", path, json.dumps(body), {**own, **headers})

    def news(self, run: str, event: str = "") -> Iterator[Any]:
        """What a page is told as the run goes on; with `event`, by the events of this name."""
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        try:
            line.request("GET", f"/api/runs/{run}/news", headers=self.headers)
            answer = line.getresponse()
            assert answer.status == 200
            name = ""
            for told in answer:
                if told.startswith(b"event: "):
                    name = told[7:].decode().strip()
                elif told.startswith(b"data: "):
                    if name == event:
                        yield json.loads(told[6:])
                    name = ""
        finally:
            line.close()

    def _ask(self, method: str, path: str, body: str | None, headers: dict[str, str]) -> Asked:
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        sent = {}
        for name, value in {**self.headers, **headers}.items():
            sent[name.replace("_", "-")] = value
        sent = {name: value for name, value in sent.items() if value}
        try:
            line.request(method, path, body, sent)
            answer = line.getresponse()
            return Asked(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read().decode())
        finally:
            line.close()


@contextmanager
def serving(folder: Path, host: str = "127.0.0.1", **rules: Any) -> Iterator[Client]:
    """Serve a lab's state on loopback, under the rules of `host`."""
    with listen_at("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        access = Access(host, port, **rules)
        server = server_of(folder, access)
        thread = threading.Thread(target=server.run, args=([listener],))
        thread.start()
        try:
            yield Client(port, access)
        finally:
            server.should_exit = True
            thread.join()
