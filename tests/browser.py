"""A page in Debian's Chromium, for tests: what it asks for from outside, and what it complains of, fails them."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt install chromium)")


WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""3D, drawn without a graphics card."""
_SLOW = "GPU stall due to ReadPixels"
"""What a browser says of that."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for all tests of a module; a longer life would keep asyncio from others."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *WEBGL])
        yield found
        found.close()


@contextmanager
def browser_page(browser: Any, origin: str = "file:", **options: Any) -> Iterator[Any]:
    """A page of its own; at the end nothing foreign to `origin` was asked for, and nothing was complained of."""
    wrong: list[str] = []
    page = browser.new_page(**options)
    page.on("console", lambda said: wrong.append(said.text) if _is_complaint(said) else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda asked: None if _is_own(asked.url, origin) else wrong.append(f"asked for {asked.url}"))
    try:
        yield page
    finally:
        page.close()
    assert wrong == []


def serious_faults(page: Any) -> list[str]:
    """What axe-core finds that keeps a person from using the page."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [f"{one['id']}: {one['help']}" for one in found if one["impact"] in ("serious", "critical")]


def _is_own(url: str, origin: str) -> bool:
    return url.startswith((origin, "data:", "about:", "blob:"))


def _is_complaint(said: Any) -> bool:
    return said.type in ("error", "warning") and _SLOW not in said.text
