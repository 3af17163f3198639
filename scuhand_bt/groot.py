"""The running job, shown by the Groot2 protocol (BehaviorTree.CPP 4.8) to Groot2, btview and their kin.

The protocol is ZeroMQ's request and reply. A request's first part is a header, little-endian: protocol (u8), kind
(u8), number (u32). The answer's first part is that header and the 16 bytes of the tree's own id, its second one what
was asked for; or they are "error" and why. Source: BehaviorTree.CPP's `groot2_protocol.h`, `groot2_publisher.cpp`.

Only this computer reaches it. A thread of its own answers, so many times a second at most; the run's tick notes the
states of its nodes when they change, and waits for nobody. Breakpoints are refused: nobody holds up a dose by them.
"""

import struct
import threading
import time
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from uuid import uuid4

import msgpack
import zmq
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector

from scuhand_bt.journal.plain import plain_values
from scuhand_bt.problems import SourceError
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.tree.btlive import CONDITION, LiveNode, LiveTree, live_tree
from scuhand_bt.tree.build import Tree
from scuhand_bt.tree.nodes import Chosen

PORT = 1667
"""Groot2's own."""
PROTOCOL = 2
LONGEST = 65536
"""Bytes that one can ask at once."""
LOOK_MS = 100
"""So often the thread sees whether the run is over."""
PAUSE_S = 0.005
"""Between two answers: who asks without end has a few hundred a second, and the run the processor."""
MOST_TRANSITIONS = 1000
"""Kept while they are being recorded, as BehaviorTree.CPP does."""
IDLE, RUNNING, SUCCESS, FAILURE = range(4)
BEFORE = 10
"""Is added to the state that a node had before it became idle."""
_STATES = {Status.INVALID: IDLE, Status.RUNNING: RUNNING, Status.SUCCESS: SUCCESS, Status.FAILURE: FAILURE}
_HEADER = struct.Struct("<BBI")


class Refused(Exception):  # noqa: N818 - it is an answer
    """Why a request has no answer."""


class Publisher(BatchObserver):
    """Answers from when it is made until it is closed; port 0 takes a free one. OSError for a port that is taken."""

    def __init__(self, port: int = PORT) -> None:
        self._context = zmq.Context()
        self._server = self._context.socket(zmq.REP)
        self._server.setsockopt(zmq.LINGER, 0)
        self._server.setsockopt(zmq.MAXMSGSIZE, LONGEST)
        try:
            self._server.bind(f"tcp://127.0.0.1:{port or '*'}")
        except zmq.ZMQError as error:
            self._context.destroy(linger=0)
            raise OSError(error.errno, error.strerror) from None
        self.port = int(self._server.getsockopt_string(zmq.LAST_ENDPOINT).rpartition(":")[2])
        self._shown: _Shown | None = None
        self._recording: _Recording | None = None
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True, name="groot")
        self._thread.start()

    def __enter__(self) -> "Publisher":
        return self

    def __exit__(self, *exception: object) -> None:
        self._is_over.set()
        self._thread.join()

    def tree_made(self, tree: Tree) -> None:
        self._shown = _Shown(tree)

    def ticked(self, root: Behaviour) -> None:
        if self._shown is not None:
            self._shown.ticked(self._recording)

    def _serve(self) -> None:
        while not self._is_over.is_set():
            if self._server.poll(LOOK_MS):
                self._server.send_multipart(self._answer(self._server.recv_multipart()))
                time.sleep(PAUSE_S)
        self._context.destroy(linger=0)

    def _answer(self, parts: Sequence[bytes]) -> list[bytes]:
        try:
            return self._answered(parts)
        except (Refused, SourceError) as why:
            return [b"error", str(why).encode()]
        except Exception as error:  # whatever is asked, the next one is answered
            return [b"error", f"{type(error).__name__}: {error}".encode()]

    def _answered(self, parts: Sequence[bytes]) -> list[bytes]:
        header, asked = parts[0], parts[1].decode() if len(parts) == 2 else None
        if len(header) != _HEADER.size:
            raise Refused("wrong request header")
        _, kind, number = _HEADER.unpack(header)
        if (shown := self._shown) is None:
            raise Refused("no job has begun yet")
        head = _HEADER.pack(PROTOCOL, kind, number) + shown.id
        match chr(kind):
            case "T":
                return [head, shown.live.xml.encode()]
            case "S":
                return [head, shown.states()]
            case "B" | "r" if asked is None:
                raise Refused("must be 2 parts message")
            case "B":
                return [head, msgpack.packb(shown.blackboards(asked or ""))]
            case "r" if asked == "start":
                self._recording = _Recording()
                return [head, str(time.time_ns() // 1000).encode()]
            case "r":
                self._recording = None
                return [head]
            case "t":
                return [head, self._recording.taken(shown) if self._recording is not None else b""]
            case "D":
                return [head, b"[]"]  # no breakpoints
            case "A" | "X":
                return [head]
            case "I" | "R" | "U":
                raise Refused("a run is not held up by breakpoints")
            case _:
                raise Refused("Request not recognized")


class _Recording:
    """The changes of nodes' states since it was begun."""

    def __init__(self) -> None:
        self._began_ns = time.monotonic_ns()
        self._changes: deque[tuple[_Shown, int, int, int]] = deque(maxlen=MOST_TRANSITIONS)

    def note(self, shown: "_Shown", place: int, state: int) -> None:
        self._changes.append((shown, place, (time.monotonic_ns() - self._began_ns) // 1000, state))

    def taken(self, shown: "_Shown") -> bytes:
        """Those of this tree, and none of them again: 6 bytes of time [µs], 2 of the node's number, its state."""
        changes = [self._changes.popleft() for _ in range(len(self._changes))]  # others may come meanwhile
        return b"".join(
            at_us.to_bytes(6, "little") + struct.pack("<HB", uid, state)
            for of, place, at_us, state in changes
            if of is shown and (uid := shown.uid_of(place)) is not None
        )


class _Shown:
    """A job's tree, and its nodes' states as they were after the last tick.

    What a place of `_codes` is of: first our nodes, from the root, each before what is below it, then for each
    `Chosen` the condition and the way that only the format has.
    """

    def __init__(self, tree: Tree) -> None:
        self.id = uuid4().bytes
        self._tree = tree
        self._nodes = _nodes(tree.root)
        places = {node: place for place, node in enumerate(self._nodes)}
        fallbacks = [node for node in self._nodes if isinstance(node, Selector)]
        self._fallbacks = [(node, [places[child] for child in node.children]) for node in fallbacks]
        self._chosen = {place: node for place, node in enumerate(self._nodes) if isinstance(node, Chosen)}
        self._before: list[Status] = []
        self._codes = bytes(len(self._nodes) + 2 * len(self._chosen))

    @cached_property
    def live(self) -> LiveTree:
        """Made in the thread that answers, when it is first asked for."""
        return live_tree(self._tree.library, self._tree.workflow.name)

    @cached_property
    def _places(self) -> list[int]:
        """Of each node of the file."""
        return [self._place(node) for node in self.live.nodes]

    def _place(self, node: LiveNode) -> int:
        if not node.only_there:
            return node.number
        number = list(self._chosen).index(node.number)
        return len(self._nodes) + 2 * number + (node.only_there != CONDITION)

    def uid_of(self, place: int) -> int | None:
        """The number in the file of what is at this place; None for what it does not have."""
        return self._places.index(place) + 1 if place in self._places else None

    def ticked(self, recording: _Recording | None) -> None:
        """Note the states, if they have changed."""
        now = [node.status for node in self._nodes]
        if now == self._before:
            return
        self._before = now
        states = [_STATES[status] for status in now]
        for fallback, children in self._fallbacks:
            tried = fallback.current_child
            if fallback.status is not Status.INVALID and tried is not None:
                # It comes to a child when those before it have failed; py_trees then clears their states.
                for place in children[: fallback.children.index(tried)]:
                    states[place] = states[place] or FAILURE
        for chosen in self._chosen.values():
            states += _only_there(chosen)
        before = self._codes
        self._codes = bytes(
            state or (code + BEFORE if 0 < code < BEFORE else code) for state, code in zip(states, before, strict=True)
        )
        if recording is not None:
            for place, (code, was) in enumerate(zip(self._codes, before, strict=True)):
                if code != was:
                    recording.note(self, place, states[place])

    def states(self) -> bytes:
        """Of each node of the file its number and its state."""
        codes = self._codes
        return b"".join(struct.pack("<HB", uid, codes[place]) for uid, place in enumerate(self._places, 1))

    def blackboards(self, names: str) -> dict[str, object]:
        """The values of the workflows that are named, divided by ';', or of all; what nothing is called is left out."""
        wanted = [name for name in names.split(";") if name] or self.live.scopes
        scopes = dict(zip(self.live.scopes, self._tree.scopes, strict=True))
        return {name: plain_values(dict(scopes[name].values)) for name in wanted if name in scopes}


def _nodes(root: Behaviour) -> list[Behaviour]:
    """From the root, each before what is below it."""
    return [root, *(node for child in root.children for node in _nodes(child))]


def _only_there(chosen: Chosen) -> tuple[int, int]:
    """The states of what an `if` asks, and of the way that an `if` or a `switch` does not have."""
    if chosen.status is Status.INVALID:
        return IDLE, IDLE
    if chosen.current_child is not None:
        return (SUCCESS if chosen.current_child is chosen.children[0] else FAILURE), IDLE
    return FAILURE, SUCCESS if chosen.failure is None else FAILURE
