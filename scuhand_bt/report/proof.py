"""What is proven of a run's journal, and what is not: by its own chain, by the lab's ledger, by a noted head."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from scuhand_bt.journal.archive import summary_of
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.lab_state.ledger import Kept, LedgerFound
from scuhand_bt.quantity import counted

NO_CHAIN = "an older scuhand-bt wrote it, without a chain: whether it was altered cannot be told"


@dataclass
class Proof:
    """What holds, in sentences. With a `problem` the journal is not what was written, and the rest is empty."""

    problem: str | None = None
    proven: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    """What nothing here can tell."""


def proof_of(contents: Contents, ledger: LedgerFound, head: str | None = None, key: str | None = None) -> Proof:
    """All that can be told of a journal that has a chain.

    `head` was noted elsewhere, and `contents` were opened with it; `key` is the public key that the lab signs with.
    Raises SourceError for lines that are signed, without `cryptography`.
    """
    verified = contents.verified
    problem = verified.problem or _of_another_run(contents)
    lines = ledger.of(contents.path.stem)
    problem = problem or (ledger.problem and f"the lab's ledger is not as it was written: {ledger.problem}")
    problem = problem or _against(contents, ledger, lines)
    if problem is None and key is not None:
        problem = _unsigned(lines, key)
    if problem is not None:
        return Proof(problem)
    proof = Proof()
    proof.proven.append(
        f"Its {verified.entries} entries fit together: none of them was altered, removed or put in by itself."
    )
    if head is not None:
        proof.proven.append("The head is the one that was noted: nothing was altered, added or cut off since.")
    _tell_of_ledger(proof, contents, ledger, lines, key)
    state = summary_of(contents.path, contents.database).state
    if state == "interrupted":
        proof.open.append("The run has no end: it was interrupted, or its end was cut off.")
    elif state in ("running", "paused"):
        proof.open.append(f"The run has no end yet: it is {state}.")
    if head is None and key is None:
        proof.open.append(
            "Whoever may write here could have written a whole other chain"
            + (", ledger and later runs" if lines else "")
            + ": a head noted elsewhere (--head) or a signature (--key) would show it."
        )
    proof.open.append("The times are those of this computer's clock, and names are as they were given.")
    return proof


def _of_another_run(contents: Contents) -> str | None:
    its_name = _begun(contents).get("run", contents.path.stem)
    return None if its_name == contents.path.stem else f"it is the journal of another run, {its_name}"


def _begun(contents: Contents) -> dict[str, Any]:
    """The payload of its first words, if it has any."""
    query = "SELECT payload FROM entry WHERE kind = ? ORDER BY seq LIMIT 1"
    row = contents.database.execute(query, (RunBegun.KIND,)).fetchone()
    found: dict[str, Any] = json.loads(row[0]) if row is not None else {}
    return found


def _against(contents: Contents, ledger: LedgerFound, lines: Sequence[Kept]) -> str | None:
    """What of the journal is not as the ledger has it."""
    for line in (one.line for one in lines):
        found = contents.database.execute("SELECT hash FROM entry WHERE seq = ?", (line.entries,)).fetchone()
        if found is None:
            return f"the lab's ledger has {line.entries} entries of it, at {line.at}: those at its end are missing"
        if found[0].hex() != line.head:
            return f"it was written anew: entry {line.entries} is not the one that the lab's ledger has, of {line.at}"
    before = _begun(contents).get("ledger")
    if lines and before is not None and not ledger.holds(before):
        return "the lab's ledger was written anew: it never had the head that the run's first entry names"
    return None


def _unsigned(lines: Sequence[Kept], key: str) -> str | None:
    for one in lines:
        if one.line.key != key or not one.is_signed:
            return f"line {one.line.number} of the lab's ledger, which is about it, is not signed with this key"
    return None if lines else "no line of the lab's ledger is about it, and so none is signed"


def _tell_of_ledger(
    proof: Proof, contents: Contents, ledger: LedgerFound, lines: Sequence[Kept], key: str | None
) -> None:
    if not lines:
        proof.open.append("The lab's ledger has no line about it: it is older than the ledger, or came from elsewhere.")
        return
    last = lines[-1].line
    rest = contents.verified.entries - last.entries
    lines_kept = counted(len(ledger.kept), "line")
    proof.proven.append(
        f"The lab's ledger ({lines_kept}, whole, head {ledger.head}) has its head of {last.at}, after "
        f"entry {last.entries}: nothing until there was altered or cut off since, unless the ledger was rewritten too."
    )
    if key is not None:
        proof.proven.append("What the ledger has of it is signed with this key: only its owner can have written that.")
    if rest:
        which = "The last entry is" if rest == 1 else f"The last {rest} entries are"
        proof.open.append(f"{which} not in the ledger: the run did not end by itself, or goes on.")
