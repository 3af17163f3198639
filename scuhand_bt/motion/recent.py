"""A cache of the last answers, by request."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Asked = TypeVar("Asked", bound=Hashable)
Answer = TypeVar("Answer")


class Recent(Generic[Asked, Answer]):
    """A least-recently-used cache with at most `most` answers, counting the one that is being made."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._answers: OrderedDict[Asked, Answer] = OrderedDict()

    def of(self, asked: Asked, make: Callable[[], Answer], is_kept: Callable[[], bool] = lambda: True) -> Answer:
        """The answer, made if it is not cached. After that, `is_kept` decides whether it is cached."""
        if asked in self._answers:
            self._answers.move_to_end(asked)
            return self._answers[asked]
        self._make_room()  # before it is made, as answers may be large
        answer = make()
        if is_kept():
            self._make_room()  # making it may have added others
            self._answers[asked] = answer
        return answer

    def _make_room(self) -> None:
        if len(self._answers) >= self._most:
            self._answers.popitem(last=False)
