"""The command line. Each command is a few lines over the public API; heavy imports wait until they are needed."""

from scuhand_bt.cli import archive, balance, batch, bench, content, failures, inventory, look, ongoing
from scuhand_bt.cli.shared import app, main

__all__ = ["app", "archive", "balance", "batch", "bench", "content", "failures", "inventory", "look", "main", "ongoing"]
