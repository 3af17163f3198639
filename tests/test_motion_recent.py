"""What a planner keeps: the last answers, and no more."""

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
