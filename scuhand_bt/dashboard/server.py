"""The dashboard's pages and what they ask for.

It reads journals, and says wishes and answers over the run's own socket (`run/control.py`): nothing that comes here can
change a run in any other way, and a run does not know whether it is there.
"""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, HTTPException, Query, Request
from fastapi.responses import FileResponse, JSONResponse, Response, StreamingResponse
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp

from scuhand_bt.dashboard.access import Access
from scuhand_bt.dashboard.balances import Balances
from scuhand_bt.dashboard.guard import Guard
from scuhand_bt.dashboard.page_state import Page
from scuhand_bt.journal.archive import summaries
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.lab_state.lab_db import user_name
from scuhand_bt.problems import SourceError
from scuhand_bt.report import viewer
from scuhand_bt.run.control import HEARD, Shown, Wish, say_answer, say_wish, waiting_question
from scuhand_bt.run.questions import Question

STATIC = Path(__file__).parent / "static"
LOOK_S = 0.1
"""So often it is seen whether a run's journal has grown."""
BREATH_S = 1.0
"""And so often whether a process still has the run."""
MOST_PAGES = 40
"""Pages that are told of runs at once."""
LATEST = 1e9
"""Run time that no run reaches [s]."""
Seconds = Annotated[float, Query(ge=0, le=LATEST, allow_inf_nan=False)]


class Wished(BaseModel):
    """What is wished of a run, and by whom: with a PIN where the name has one."""

    wish: Wish
    name: str | None = Field(default=None, max_length=200)
    pin: str | None = Field(default=None, max_length=200)


class AnswerGiven(BaseModel):
    """An answer to the question of this number."""

    number: int = Field(ge=0, le=2**53)
    answer: str = Field(max_length=200)
    name: str | None = Field(default=None, max_length=200)
    pin: str | None = Field(default=None, max_length=200)


class Failed(BaseModel):
    """Why something was not done."""

    detail: str


def dashboard(folder: Path, access: Access) -> ASGIApp:
    """The application for the lab whose state is in `folder`, behind its rules."""
    runs = folder / "runs"
    drawing = threading.Lock()  # one at a time: it takes a second
    pages, balances = asyncio.Semaphore(MOST_PAGES), Balances()
    failures: dict[int | str, dict[str, Any]] = {code: {"model": Failed} for code in (400, 403, 404, 409, 413, 503)}
    app = FastAPI(title="scuhand_bt", docs_url=None, redoc_url=None, openapi_url="/api/openapi.json")
    app.router.redirect_slashes = False

    def journal(run: str) -> Path:
        """The journal of this run: one of those that are in the folder, and nothing else."""
        found = next((path for path in runs.glob("*.sqlite") if path.stem == run), None)
        if found is None or found.resolve().parent != runs.resolve():
            raise HTTPException(404, "there is no such run")
        return found

    @app.exception_handler(SourceError)
    async def unreadable(request: Request, error: Exception) -> Response:
        assert isinstance(error, SourceError)
        return JSONResponse({"detail": error.problems[0].message}, status_code=409)

    @app.get("/", include_in_schema=False)
    def index() -> FileResponse:
        return FileResponse(STATIC / "runs.html")

    @app.get("/runs/{run}", include_in_schema=False)
    def page(run: str) -> FileResponse:
        journal(run)
        return FileResponse(STATIC / "run.html")

    @app.get("/api/session")
    def session() -> dict[str, Any]:
        """What a page has to know of the dashboard."""
        return {"word": access.word, "may_control": access.allows_control, "user": user_name()}

    @app.get("/api/runs")
    def all_runs(limit: Annotated[int, Query(ge=1, le=10_000)] = 200) -> list[dict[str, Any]]:
        """The runs, the newest first."""
        return [
            {
                "id": one.id,
                "state": one.state,
                "reason": one.reason,
                "recipe": one.recipe,
                "mode": one.mode,
                "started": one.started,
                "good": one.good,
                "total": one.total,
            }
            for one in summaries(runs)[:limit]
        ]

    @app.get("/api/runs/{run}", responses=failures)
    def at(run: str, time_s: Seconds = LATEST) -> dict[str, Any]:
        """A run as it was at a moment of its time."""
        path = journal(run)
        told = Page(Follower(path, until_s=time_s)).news(is_held=time_s < LATEST or is_held(path))
        return {**told, "ends_s": _last_s(path)}

    @app.get("/api/runs/{run}/news", responses=failures)
    async def news(run: str, request: Request) -> StreamingResponse:
        """A run as it goes on, as server-sent events: all there is, and then what changes."""
        path = await run_in_threadpool(journal, run)
        if pages.locked():
            raise HTTPException(503, "too many pages are open")

        async def telling() -> AsyncIterator[str]:
            async with pages:
                async for told in _followed(path, balances):
                    yield told

        return StreamingResponse(telling(), media_type="text/event-stream")

    @app.post("/api/runs/{run}/wish", responses=failures)
    def wish(run: str, wished: Wished) -> dict[str, str]:
        """Pause, continue or stop a run."""
        return _heard(lambda path: say_wish(path, wished.wish, wished.name, wished.pin), journal(run))

    @app.post("/api/runs/{run}/answer", responses=failures)
    def answer(run: str, given: AnswerGiven) -> dict[str, str]:
        """Answer the question that a run waits with."""
        asked = Question(given.number, "", (), "")
        return _heard(lambda path: say_answer(path, asked, given.answer, given.name, given.pin), journal(run))

    @app.get("/api/runs/{run}/scene", responses=failures)
    def scene(run: str) -> dict[str, Any]:
        """The cell in 3D, with which `/static/viewer/viewer.js` draws it."""
        from scuhand_bt.report.run_scene import run_scene

        path = journal(run)
        with drawing:
            return run_scene(path)

    @app.get("/static/viewer/{name:path}", include_in_schema=False)
    def viewer_module(name: str) -> Response:
        if name not in viewer.MODULES:
            raise HTTPException(404, "there is no such file")
        return Response(viewer.module(name), media_type="text/javascript")

    app.mount("/static", StaticFiles(directory=STATIC))
    return Guard(app, access)


def _heard(say: Any, journal: Path) -> dict[str, str]:
    """What the process that has the run answers."""
    try:
        said = say(journal)
    except TimeoutError:
        said = "the run does not answer"
    if said is None:
        said = "the run is not running"
    if said != HEARD:
        raise HTTPException(409, said)
    return {"said": said}


def _last_s(journal: Path) -> float:
    """Run time of the last entry."""
    with open_journal(journal) as (database, _):
        return float(database.execute("SELECT COALESCE(MAX(time_s), 0) FROM entry").fetchone()[0])


async def _followed(journal: Path, balances: Balances) -> AsyncIterator[str]:
    """What there is to tell of a run, each time that something has changed, and what its balance shows."""
    page, seen, held, looked_s = Page(Follower(journal)), None, False, -BREATH_S
    balance: Shown | None = None
    asked: Question | None = None
    since = ""
    while True:
        if (now_s := time.monotonic()) - looked_s >= BREATH_S:
            looked_s, held = now_s, is_held(journal)
            yield ": still here\n\n"  # and whoever has gone is noticed
        if (stamp := (held, _stamp(journal))) != seen:
            seen = stamp
            told = await run_in_threadpool(page.news, is_held=held)
            if (question := told.get("question")) is not None:
                if asked is None or since != question["since"]:
                    asked, since = await run_in_threadpool(_waiting, journal), question["since"]
                question["number"] = asked.number if asked is not None else None
            yield f"data: {json.dumps(told)}\n\n"
        if (shown := balances.shown(journal) if held else None) != balance:
            balance = shown
            yield f"event: balance\ndata: {json.dumps(shown)}\n\n"
        await asyncio.sleep(LOOK_S)


def _waiting(journal: Path) -> Question | None:
    """The question that a run waits with, as its process has it: with its number."""
    try:
        return waiting_question(journal)
    except (TimeoutError, ValueError):
        return None


def _stamp(journal: Path) -> tuple[tuple[int, int], ...]:
    """What the system says of a journal's files: it changes with every entry."""
    found = []
    for path in (journal, journal.with_name(journal.name + "-wal")):
        try:
            status = path.stat()
            found.append((status.st_size, status.st_mtime_ns))
        except OSError:
            found.append((0, 0))
    return tuple(found)
