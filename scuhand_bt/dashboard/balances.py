"""What the balances of runs show now, for the pages that are open: each is asked for once for all of them."""

import asyncio
from pathlib import Path

from starlette.concurrency import run_in_threadpool

from scuhand_bt.run.control import Shown, balance_now

ASK_S = 0.2


class Balances:
    """Asks the runs' own processes, and lets nobody wait for them."""

    def __init__(self) -> None:
        self._shown: dict[Path, Shown | None] = {}
        self._asking: dict[Path, asyncio.Task[None]] = {}

    def shown(self, journal: Path) -> Shown | None:
        """What was heard last of a run that goes on; asked for anew where that was a while ago."""
        if (asking := self._asking.get(journal)) is None or asking.done():
            self._asking[journal] = asyncio.create_task(self._ask(journal))
        return self._shown.get(journal)

    async def _ask(self, journal: Path) -> None:
        try:
            self._shown[journal] = await run_in_threadpool(balance_now, journal)
        except (TimeoutError, ValueError):
            self._shown[journal] = None
        await asyncio.sleep(ASK_S)
