"""The last answers, by what was asked: what a long run asks for again is at hand, and what it does not is let go."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Asked = TypeVar("Asked", bound=Hashable)
Answer = TypeVar("Answer")


class Recent(Generic[Asked, Answer]):
    """At most so many answers are kept, the next one's making included; what was not asked for longest goes first."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._answers: OrderedDict[Asked, Answer] = OrderedDict()

    def of(self, asked: Asked, make: Callable[[], Answer], is_kept: Callable[[], bool] = lambda: True) -> Answer:
        """The answer, made if it is not at hand; once it is made, `is_kept` tells whether it is to be."""
        if asked in self._answers:
            self._answers.move_to_end(asked)
            return self._answers[asked]
        self._make_room()  # an answer may be large, and another one beside all that are kept too much
        answer = make()
        if is_kept():
            self._make_room()  # what made it may have asked as well
            self._answers[asked] = answer
        return answer

    def _make_room(self) -> None:
        if len(self._answers) >= self._most:
            self._answers.popitem(last=False)
