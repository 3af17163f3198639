"""A run shown by the Groot2 protocol: btview's own client, which is not ours, sees the states that the journal has."""

import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from conftest import REPOSITORY, Call, LabFolder

from harness.ports import unused_port
from scuhand_bt import api
from scuhand_bt.journal.follow import Follower
from scuhand_bt.lab import Lab
from scuhand_bt.report.watching import tree_of
from scuhand_bt.tree.btlive import live_tree

zmq = pytest.importorskip("zmq")
pytest.importorskip("msgpack")
client = pytest.importorskip("btview.client")

from scuhand_bt.groot import Publisher  # noqa: E402 - it needs what may not be there

SHIPPED = sorted(path.stem for path in (REPOSITORY / "trees").glob("*.yaml") if ".test" not in path.name)
OF_THE_FORMAT = ("ScriptCondition", "AlwaysSuccess", "AlwaysFailure")
SOURCE = {"station": "mortar_bay", "container": "agate_mortar", "powder": "glass_beads", "amount": "5 g"}
RECIPE: dict[str, Any] = {
    "sources": {"beads": SOURCE},
    "defaults": {"source": "beads", "container": "xrd_holder"},
    "samples": [
        {"id": "a", "workflow": "prime_and_fill", "mass": "50 mg", "waste": "xrd_holder"},
        {"id": "b", "workflow": "fill_xrd_holder", "mass": "20 mg"},
    ],
}


class AtEveryChange(api.BatchObserver):
    """Calls `look` after each tick that has changed the state of a node."""

    def __init__(self, look: Any) -> None:
        self._look, self._before = look, []

    def ticked(self, root: Any) -> None:
        now = [node.status for node in root.iterate()]
        if now != self._before:
            self._before = now
            self._look(root)


@pytest.fixture(scope="module")
def lab() -> api.OpenLab:
    return api.open_lab(REPOSITORY)


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    with Publisher(0) as made:
        yield made


@pytest.fixture
def viewer(publisher: Publisher) -> Iterator[Any]:
    made = client.Groot2Client(port=publisher.port, timeout_ms=20_000)
    yield made
    made.close()


def run(lab: api.OpenLab, folder: Path, publisher: Publisher, look: Any, recipe: Any = RECIPE) -> api.BatchResult:
    with api.closing(lab.prepare(recipe, api.DryRun(seed=1), journals=folder)) as session:
        observer = AtEveryChange(lambda root: look(session, root))
        return session.run(api.Observers(publisher, observer))


def ask(port: int, *parts: bytes) -> list[bytes]:
    with zmq.Context() as context, context.socket(zmq.REQ) as request:
        request.setsockopt(zmq.LINGER, 0)
        request.setsockopt(zmq.RCVTIMEO, 20_000)
        request.connect(f"tcp://127.0.0.1:{port}")
        request.send_multipart(parts)
        return list(request.recv_multipart())


def header(kind: str, number: int = 7) -> bytes:
    return struct.pack("<BBI", 2, ord(kind), number)


def test_btview_sees_the_states_that_the_journal_has(
    lab: api.OpenLab, tmp_path: Path, publisher: Publisher, viewer: Any
) -> None:
    said = {"running": ("RUNNING",), "done": ("SUCCESS",), "failed": ("FAILURE",), "to come": ("IDLE",)}
    said["skipped"] = ("IDLE",)
    seen: set[tuple[str, str]] = set()
    trees: list[str] = []
    follower: list[Follower] = []

    def look(session: Any, root: Any) -> None:
        follower[:] = follower or [Follower(session.journal.path)]
        follower[0].look()
        tree, states = viewer.fetch_tree(), viewer.poll().statuses
        trees.append(tree.name)
        nodes = [node for node in tree.walk() if node.registration not in OF_THE_FORMAT]
        in_journal = tree_of(follower[0])
        assert len(nodes) == len(in_journal)
        for node, recorded in zip(nodes, in_journal, strict=True):
            if not node.children:  # what stands above them is worked out of these by whoever shows it
                assert node.registration == recorded.name
                now = states[node.uid].status.name
                assert now in said[recorded.state], (tree.name, node.registration, node.uid, recorded.state)
                seen.add((node.registration, now))
        assert len({node.uid for node in tree.walk()}) == len(states)
        assert states[1].status.name == root.status.name.replace("INVALID", "IDLE")

    result = run(lab, tmp_path, publisher, look)
    assert [sample.verdict for sample in result.samples] == ["in tolerance"] * 2
    assert {"prime_and_fill", "fill_xrd_holder"} <= set(trees)
    assert {("dispense", "RUNNING"), ("dispense", "SUCCESS"), ("cone_holds", "FAILURE"), ("scoop", "IDLE")} <= seen


def test_a_node_that_is_idle_again_says_what_it_was(
    lab_folder: LabFolder, tmp_path: Path, publisher: Publisher, viewer: Any
) -> None:
    lab_folder.write(
        "trees/twice.yaml",
        "workflow: twice\ntree: {sequence: [{repeat: {times: 2, child: {sequence: [{wait: {duration: 1 s}}, "
        "{wait: {duration: 2 s}}]}}}, {timeout: {duration: 1 s, child: {wait: {duration: 9 s}}}}]}\n",
    )
    seen: list[tuple[int, ...]] = []

    def look(session: Any, root: Any) -> None:
        if viewer.fetch_tree().name == "twice":
            seen.append(tuple(viewer.poll().statuses[uid].raw for uid in (4, 5, 7)))

    recipe = {"workflow": "twice", "samples": [{"id": "a"}], "on_failure": {"otherwise": "flag"}}
    result = run(api.open_lab(lab_folder.folder), tmp_path, publisher, look, recipe)
    assert result.reason == ""
    assert seen == [(1, 0, 0), (2, 1, 0), (2, 2, 0), (1, 12, 0), (2, 1, 0), (2, 2, 1), (2, 2, 11)]


def test_what_only_the_format_has_says_which_way_was_gone(
    lab_folder: LabFolder, tmp_path: Path, publisher: Publisher, viewer: Any
) -> None:
    lab_folder.write(
        "trees/ways.yaml",
        "workflow: ways\ninputs: {times: Integer}\ntree:\n  sequence:\n"
        "    - if: {when: $times > 1, then: {wait: {duration: 1 s}}}\n    - wait: {duration: 1 s}\n"
        '    - switch: {value: $times, cases: {"1": {wait: {duration: 1 s}}, "2": {wait: {duration: 2 s}}}}\n',
    )
    seen: dict[str, list[str]] = {}

    def look(session: Any, root: Any) -> None:
        tree, states = viewer.fetch_tree(), viewer.poll().statuses
        job = viewer.tree_uuid
        if tree.name == "ways":
            ours = [node for node in tree.walk() if node.registration in OF_THE_FORMAT]
            assert [node.registration for node in ours] == ["ScriptCondition", "AlwaysSuccess", "AlwaysFailure"]
            seen[job] = [states[node.uid].status.name for node in ours]

    samples = [{"id": f"n{times}", "times": times} for times in (2, 1)]
    recipe = {"workflow": "ways", "samples": samples, "on_failure": {"otherwise": "flag"}}
    assert run(api.open_lab(lab_folder.folder), tmp_path, publisher, look, recipe).reason == ""
    assert list(seen.values()) == [["SUCCESS", "IDLE", "IDLE"], ["FAILURE", "SUCCESS", "IDLE"]]


@pytest.mark.parametrize("name", SHIPPED)
def test_btview_reads_every_shipped_workflow_as_it_is_built(starter: Lab, name: str) -> None:
    from btview.parser import parse_bt_xml

    live = live_tree(starter.library, name)
    tree = parse_bt_xml(live.xml)
    assert [node.uid for node in tree.walk()] == list(range(1, len(live.nodes) + 1))
    root = ElementTree.fromstring(live.xml)
    models = {one.get("ID") for one in root.iterfind("TreeNodesModel/*")}
    assert {node.registration for node in tree.walk()} - {"SubTree"} <= models
    ours = [node.number for node in live.nodes if not node.only_there]
    assert ours == list(range(len(ours)))


@pytest.mark.slow
def test_the_values_of_each_workflow_are_its_blackboard(
    lab: api.OpenLab, tmp_path: Path, publisher: Publisher, viewer: Any
) -> None:
    seen: list[dict[str, Any]] = []

    def look(session: Any, root: Any) -> None:
        if viewer.fetch_tree().name == "fill_xrd_holder":
            seen.append(viewer.fetch_blackboard(["fill_xrd_holder", "nothing"]))
            seen.append(viewer.fetch_blackboard())

    run(lab, tmp_path, publisher, look)
    named, everything = seen[-2:]
    assert list(named) == ["fill_xrd_holder"]
    assert (named["fill_xrd_holder"]["mass"], named["fill_xrd_holder"]["container"]) == (20.0, "b (xrd_holder)")
    called = next(values for name, values in everything.items() if name.startswith("fill::"))
    assert called["mass"] == 20.0


def test_whatever_is_asked_is_answered_as_behaviortree_cpp_answers_it(
    lab: api.OpenLab, tmp_path: Path, publisher: Publisher
) -> None:
    bt = pytest.importorskip("behaviortreepy")
    factory = bt.BehaviorTreeFactory()
    factory.register_behavior_tree_from_text(
        '<root BTCPP_format="4"><BehaviorTree ID="A"><Sequence><AlwaysSuccess/></Sequence></BehaviorTree></root>'
    )
    tree = factory.create_tree("A")
    port = unused_port(together=2)  # theirs listens at the next one, too
    theirs = bt.Groot2Publisher(tree, port)
    asked: list[tuple[bytes, ...]] = [
        *((header(kind),) for kind in "TSDAXt"),
        *((header("B"), names) for names in (b"A", b"nothing")),
        *((header("r"), what) for what in (b"start", b"stop")),
        *((header(kind),) for kind in "BrIRUZ"),
        (b"",),
        (b"\x02T",),
        (header("T") * 2,),
    ]
    theirs_would_end = [(header("I"), b"no json"), (header("B"), b"\xff\xfe"), (header("r"), b"\xff")]
    compared: list[int] = []

    def look(session: Any, root: Any) -> None:
        if compared:
            return
        for parts in asked:
            ours, reply = ask(publisher.port, *parts), ask(port, *parts)
            assert len(ours) == len(reply), parts
            assert (ours[0] == b"error") == (reply[0] == b"error"), parts
            if reply[0] != b"error":
                assert (len(ours[0]), ours[0][:6]) == (len(reply[0]), reply[0][:6]), parts
            compared.append(len(reply))
        for garbage in theirs_would_end:
            assert ask(publisher.port, *garbage)[0] == b"error"

    run(lab, tmp_path, publisher, look)
    del theirs
    assert len(compared) == len(asked)


def test_a_workflow_that_the_format_has_no_word_for_runs_and_is_not_shown(
    lab_folder: LabFolder, tmp_path: Path, publisher: Publisher
) -> None:
    lab_folder.write(
        "trees/one_case.yaml",
        "workflow: one_case\ninputs: {times: Integer}\n"
        'tree: {switch: {value: $times, cases: {"1": {wait: {duration: 1 s}}}, otherwise: {wait: {duration: 2 s}}}}\n',
    )
    said: list[bytes] = []
    recipe = {"workflow": "one_case", "samples": [{"id": "a", "times": 1}]}

    def look(session: Any, root: Any) -> None:
        said.extend(part for kind in "TS" for part in ask(publisher.port, header(kind)))

    result = run(api.open_lab(lab_folder.folder), tmp_path, publisher, look, recipe)
    assert (result.exit_code, result.reason) == (0, "")
    assert said[0] == said[2] == b"error"
    assert b"a 'switch' of 1 cases cannot be written for BehaviorTree.CPP" in said[1]


@pytest.mark.slow
def test_transitions_are_recorded_when_asked_for(lab: api.OpenLab, tmp_path: Path, publisher: Publisher) -> None:
    found: list[tuple[int, int]] = []

    def look(session: Any, root: Any) -> None:
        if not found:
            ask(publisher.port, header("r"), b"start")
        records = ask(publisher.port, header("t"))[1]
        assert len(records) % 9 == 0
        found.extend(struct.unpack("<HB", records[at + 6 : at + 9]) for at in range(0, len(records), 9))
        if not found:
            found.append((0, 0))

    run(lab, tmp_path, publisher, look)
    assert {1, 2} <= {state for _, state in found}
    assert all(uid > 0 for uid, _ in found[1:])


@pytest.mark.slow
def test_garbage_at_the_port_and_clients_that_hang_stop_nothing(
    lab: api.OpenLab, tmp_path: Path, publisher: Publisher
) -> None:
    assert ask(publisher.port, header("T"))[0] == b"error"  # before any job
    with zmq.Context() as context:
        lines = [socket.create_connection(("127.0.0.1", publisher.port)) for _ in range(3)]
        lines[0].sendall(b"GET / HTTP/1.1\r\n\r\n")
        lines[1].sendall(bytes(range(256)) * 40)
        hanging = context.socket(zmq.DEALER)
        hanging.setsockopt(zmq.LINGER, 0)
        hanging.connect(f"tcp://127.0.0.1:{publisher.port}")
        for _ in range(500):  # asks, and never takes an answer
            hanging.send_multipart([b"", header("S")])
        answered: list[bytes] = []

        def look(session: Any, root: Any) -> None:
            if len(answered) < 3:
                answered.append(ask(publisher.port, header("S"))[0])

        result = run(lab, tmp_path, publisher, look)
        hanging.close()
        for line in lines:
            line.close()
    assert [sample.verdict for sample in result.samples] == ["in tolerance"] * 2
    assert [len(head) for head in answered] == [22] * 3


def test_who_asks_without_end_gets_a_few_hundred_answers_a_second(publisher: Publisher) -> None:
    ends, answers = time.monotonic() + 1.0, 0
    with zmq.Context() as context, context.socket(zmq.REQ) as request:
        request.connect(f"tcp://127.0.0.1:{publisher.port}")
        while time.monotonic() < ends:
            request.send(header("S"))
            request.recv_multipart()
            answers += 1
    assert 1 <= answers <= 250


def test_run_shows_its_tree_at_the_port_and_nowhere_but_on_this_computer(command: Call, lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/one.yaml", json.dumps({"recipe": "one", **RECIPE}))
    port = unused_port()
    with socket.create_server(("127.0.0.1", port)):
        taken = command("run", recipe, "--dry-run", "--groot", port)
    assert taken.returncode == 2
    assert f"cannot listen at port {port}" in taken.stderr.replace("\n", " ")
    seen: set[str] = set()
    over = threading.Event()

    def watch() -> None:
        viewer = client.Groot2Client(port=port, timeout_ms=500)
        while not over.is_set():
            try:
                seen.add(viewer.fetch_tree().name)
            except Exception:  # there is no run yet, or no job
                time.sleep(0.02)
        viewer.close()

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        ended = command("run", recipe, "--dry-run", "--groot", port)
    finally:
        over.set()
        thread.join()
    assert ended.returncode == 0
    assert {"prime_and_fill", "fill_xrd_holder"} <= seen
    with Publisher(0) as made, pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", made.port), timeout=5)
