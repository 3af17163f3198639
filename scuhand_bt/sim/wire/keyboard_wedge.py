"""The twin of a keyboard wedge: types the code of the container in front of it, every second, and Enter."""

from typing import Any

from scuhand_bt.sim.wire.scene import Scene

_LETTERS = ("1234567890-=", "qwertyuiop[]", "asdfghjkl;'`", "\\zxcvbnm,./", " ")
_SHIFTED = ("!@#$%^&*()_+", "QWERTYUIOP{}", 'ASDFGHJKL:"~', "|ZXCVBNM<>?", " ")
_FIRST = (2, 16, 30, 43, 57)
_US = {
    letter: (first + i, is_shifted)
    for rows, is_shifted in ((_SHIFTED, True), (_LETTERS, False))
    for row, first in zip(rows, _FIRST, strict=True)
    for i, letter in enumerate(row)
}
"""The key of a character, and whether it needs shift. From linux/input-event-codes.h."""
ENTER, LEFT_SHIFT = 28, 42


def _event(kind: int, code: int, value: int) -> bytes:
    parts = ((0, 8), (0, 8), (kind, 2), (code, 2), (value, 4))
    return b"".join(number.to_bytes(size, "little") for number, size in parts)


def _stroke(code: int) -> bytes:
    return b"".join(_event(1, code, value) + _event(0, 0, 0) for value in (1, 0))


def typed(text: str) -> bytes:
    """The events of a text and Enter, as a keyboard sends them. Raises KeyError for a character without a key."""
    said = b""
    for code, is_shifted in map(_US.__getitem__, text):
        stroke = _stroke(code)
        said += _event(1, LEFT_SHIFT, 1) + stroke + _event(1, LEFT_SHIFT, 0) if is_shifted else stroke
    return said + _stroke(ENTER)


class KeyboardWedgeTwin:
    """Set to read the same code again after a second."""

    period_s = 1.0

    def __init__(self, options: Any, scene: Scene) -> None:
        self.scene = scene
        self._next_s = 0.0

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """The code of the container on the pan, when it is due; input is ignored."""
        code = self.scene.on_pan
        if code is None or not code.isascii() or now_s < self._next_s:
            return []
        self._next_s = now_s + self.period_s
        return [typed(code)]
