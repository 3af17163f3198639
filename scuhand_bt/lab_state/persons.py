"""Persons who sign with a PIN: who they are is kept in the lab's database, and of the PIN only a salted hash (scrypt).

Rows are only ever added: the last one of a name counts, the others are its history.
"""

import hashlib
import hmac
import secrets
import unicodedata
from pathlib import Path

from scuhand_bt.clock import wall_time
from scuhand_bt.lab_state.lab_db import reading_lab_db, writing_lab_db
from scuhand_bt.problems import harmless

SHORTEST_PIN = 6
LONGEST_NAME = 80
_SCRYPT = {"n": 2**14, "r": 8, "p": 1}
"""RFC 7914's for an interactive log-in: 16 MB and some 50 ms for every guess."""


def person_name(text: str) -> str:
    """A person's name as it is kept. Raises ValueError for none, and for what cannot be read."""
    name = " ".join(unicodedata.normalize("NFC", text).split())
    if not name or len(name) > LONGEST_NAME or harmless(name) != name:
        raise ValueError(f"a person's name must have 1 to {LONGEST_NAME} visible characters")
    return name


class Persons:
    """Those of a lab; `folder` holds its database. See `lab_db.py` for the errors of reading and writing."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """Everybody who signs with a PIN."""
        return sorted({name for _, name in self.enrolled()})

    def enrolled(self) -> list[tuple[str, str]]:
        """When who got a PIN, the first or another."""
        with reading_lab_db(self._folder) as database:
            return database.execute("SELECT at, name FROM person ORDER BY number").fetchall() if database else []

    def enrol(self, name: str, pin: str) -> None:
        """Let a person sign with this PIN from now on. ValueError for a name that is none, or too short a PIN."""
        name = person_name(name)
        if len(pin) < SHORTEST_PIN:
            raise ValueError(f"a PIN must have at least {SHORTEST_PIN} characters")
        salt = secrets.token_bytes(16)
        at = wall_time()
        with writing_lab_db(self._folder) as database:
            row = (name, at, salt, hashlib.scrypt(pin.encode(), salt=salt, **_SCRYPT))
            database.execute("INSERT INTO person (name, at, salt, hash) VALUES (?, ?, ?, ?)", row)

    def is_pin(self, name: str, pin: str) -> bool:
        """Whether this is the person's PIN."""
        with reading_lab_db(self._folder) as database:
            query = "SELECT salt, hash FROM person WHERE name = ? ORDER BY number DESC LIMIT 1"
            row = database.execute(query, (name,)).fetchone() if database is not None else None
        return row is not None and hmac.compare_digest(hashlib.scrypt(pin.encode(), salt=row[0], **_SCRYPT), row[1])
