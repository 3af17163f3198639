"""How a command says, in one number, how it went."""

from enum import IntEnum


class ExitCode(IntEnum):
    """The exit codes of every command; `meaning` is what the help and the docs say of it."""

    meaning: str

    def __new__(cls, value: int, meaning: str) -> "ExitCode":
        code = int.__new__(cls, value)
        code._value_ = value
        code.meaning = meaning
        return code

    OK = 0, "all doses in tolerance"
    FLAGGED = 1, "finished with flagged doses"
    BAD_INPUT = 2, "bad input"
    CELL_FAULT = 3, "cell fault"
    INTERRUPTED = 130, "interrupted"
    UNREAD = 141, "nobody reads the output any more"
    """As a shell tells it of a tool that SIGPIPE has ended, 128 + 13."""
