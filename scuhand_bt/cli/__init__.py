"""The command line. Each command is a few lines over the public API; heavy imports wait until they are needed."""

from scuhand_bt.cli import (
    archive,
    balance,
    batch,
    bench,
    content,
    evidence,
    failures,
    inventory,
    keeping,
    look,
    ongoing,
    persons,
    powders,
    report,
    study,
    watch,
)
from scuhand_bt.cli.shared import app, main

__all__ = [
    "app",
    "archive",
    "balance",
    "batch",
    "bench",
    "content",
    "evidence",
    "failures",
    "inventory",
    "keeping",
    "look",
    "main",
    "ongoing",
    "persons",
    "powders",
    "report",
    "study",
    "watch",
]
