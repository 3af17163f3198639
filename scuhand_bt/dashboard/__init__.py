"""The dashboard: a process of its own that shows a lab's runs on a page, and speaks to them as the commands do."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.dashboard.access import Access, is_loopback, kept_token, new_token
    from scuhand_bt.dashboard.serving import listen_at, serve_at
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "dashboard.access": "Access is_loopback kept_token new_token",
            "dashboard.serving": "listen_at serve_at",
        },
    )

__all__ = [
    "Access",
    "is_loopback",
    "kept_token",
    "listen_at",
    "new_token",
    "serve_at",
]
