"""What a planner keeps: the last answers, and no more."""

from weakref import WeakSet

from scuhand_bt.motion.recent import Recent


def test_what_was_asked_lately_is_not_made_again() -> None:
    made: list[str] = []
    recent: Recent[str, int] = Recent(2)
    answers = [recent.of(asked, lambda asked=asked: made.append(asked) or len(made)) for asked in "aabab"]  # type: ignore[misc]
    assert made == ["a", "b"]
    assert answers == [1, 1, 2, 1, 2]


def test_what_was_not_asked_for_longest_is_let_go() -> None:
    made: list[str] = []
    recent: Recent[str, None] = Recent(2)
    for asked in "abacab":
        recent.of(asked, lambda asked=asked: made.append(asked))  # type: ignore[misc]
    assert made == ["a", "b", "c", "b"]


def test_an_answer_is_let_go_before_another_is_made_in_its_place() -> None:
    class Large:
        pass

    recent: Recent[int, Large] = Recent(2)
    alive: WeakSet[Large] = WeakSet()

    def made() -> Large:
        before.append(len(alive))
        alive.add(large := Large())
        return large

    before: list[int] = []
    for asked in range(4):
        recent.of(asked, made)
    assert before == [0, 1, 1, 1]


def test_what_is_asked_while_an_answer_is_made_counts_too() -> None:
    recent: Recent[str, str] = Recent(2)
    made: list[str] = []
    for asked in "ab":
        recent.of(asked, str)
    recent.of("c", lambda: recent.of("d", str) + recent.of("e", str))
    for asked in "ecd":
        recent.of(asked, lambda asked=asked: made.append(asked) or "")  # type: ignore[misc]
    assert made == ["d"]
