"""The file of a simulated world: a killed process leaves it whole.

    head   magic, size of a slot, check sum
    slot   check sum, generation, length of the state, length and check sum of the log up to it; the state
    slot   the same; of the two, the intact one with the higher generation counts
    log    append-only records

A state is written over the older slot through a memory map. However the process ends, the kernel keeps what was
stored, and one slot is intact. Nothing is flushed to the disk: that would protect against a power cut, which ends the
simulating computer too. A state that outgrows its slot goes to a new file, which then takes the old one's name.

A world belongs to one process: once another has taken it over, the former can no longer change it.
"""

import mmap
import os
import struct
from contextlib import suppress
from pathlib import Path
from zlib import crc32

from scuhand_bt.problems import Mark, Problem, SourceError

MAGIC = b"scuhand_bt world 4\n"
HEAD = struct.Struct("<19sII")
SUM = struct.Struct("<I")
FIELDS = struct.Struct("<QIQI")
SLOT_HEAD_BYTES = SUM.size + FIELDS.size
SLOT_BYTES = 4096
"""The least size of a new file's slots; enough for usual states."""


class WorldFile:
    """A state, and a log that grows; `write` commits both at once. Raises OSError if the disk is full."""

    def __init__(self, path: Path, generation: int = 0, log_bytes: int = 0, log_sum: int = 0) -> None:
        """For `create` and `open`."""
        self._path = path
        self._generation, self._log_bytes, self._log_sum = generation, log_bytes, log_sum

    @classmethod
    def create(cls, path: Path, state: bytes) -> "WorldFile":
        """A new file with this state; replaces an existing one."""
        made = cls(path)
        made._move(state, b"")
        return made

    @classmethod
    def open(cls, path: Path) -> "tuple[WorldFile, bytes, bytes]":
        """The file, its state and its log. Raises SourceError if it is not a world's file, or is damaged."""
        try:
            content = path.read_bytes()
        except OSError as error:
            raise broken(path, f"the simulated world cannot be read: {error.strerror}") from None
        if len(content) < HEAD.size or not content.startswith(MAGIC):
            raise broken(path, "this is not the file of a simulated world, or another version of the program wrote it")
        _, slot_bytes, head_sum = HEAD.unpack_from(content)
        if head_sum != _head_sum(slot_bytes):
            raise broken(path, "this file of a simulated world is damaged in its head")
        log_at = HEAD.size + 2 * slot_bytes
        if len(content) < log_at:
            raise broken(path, "this file of a simulated world is cut off")
        for _, begin in sorted(_whole_slots(content, slot_bytes), reverse=True):
            generation, state_bytes, log_bytes, log_sum = FIELDS.unpack_from(content, begin + SUM.size)
            log = content[log_at : log_at + log_bytes]
            if len(log) == log_bytes and crc32(log) == log_sum:
                state = content[begin + SLOT_HEAD_BYTES : begin + SLOT_HEAD_BYTES + state_bytes]
                made = cls(path, generation, log_bytes, log_sum)
                made._map(os.open(path, os.O_RDWR), slot_bytes)
                return made, state, log
        raise broken(path, "this file of a simulated world is damaged: no state in it is whole")

    def append(self, record: bytes) -> None:
        """Append to the log; it counts from the next `write` on."""
        if self._is_overtaken:
            return
        os.pwrite(self._file, record, HEAD.size + 2 * self._slot_bytes + self._log_bytes)
        self._log_bytes += len(record)
        self._log_sum = crc32(record, self._log_sum)

    def write(self, state: bytes) -> None:
        """Commit this state, and the log up to here."""
        if self._is_overtaken:
            return
        if len(state) + SLOT_HEAD_BYTES > self._slot_bytes:
            log_at = HEAD.size + 2 * self._slot_bytes
            log = os.pread(self._file, self._log_bytes, log_at)
            memory, file = self._memory, self._file
            self._move(state, log)
            memory.close()
            os.close(file)
            return
        self._generation += 1
        fields = FIELDS.pack(self._generation, len(state), self._log_bytes, self._log_sum)
        begin = HEAD.size + self._generation % 2 * self._slot_bytes
        slot = SUM.pack(crc32(state, crc32(fields))) + fields + state
        self._memory[begin : begin + len(slot)] = slot

    @property
    def _is_overtaken(self) -> bool:
        """Whether another process has written since: there is an intact state of a later generation than ours."""
        next_at = HEAD.size + (self._generation + 1) % 2 * self._slot_bytes + SUM.size
        if FIELDS.unpack_from(self._memory, next_at)[0] <= self._generation:
            return False
        return any(generation > self._generation for generation, _ in _whole_slots(self._memory, self._slot_bytes))

    def remove(self) -> None:
        """Close and delete the file."""
        self.close()
        with suppress(OSError):
            self._path.unlink()

    def close(self) -> None:
        self._memory.close()
        os.close(self._file)

    def _move(self, state: bytes, log: bytes) -> None:
        """Go to a new file with room for this state; it is complete before it gets its name."""
        slot_bytes = max(SLOT_BYTES, 2 * (len(state) + SLOT_HEAD_BYTES))
        new = self._path.with_name(f"{self._path.name}.new")
        file = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
        # Write the zeros: a full disk is then an error here, not a SIGBUS in the process that maps the file.
        os.write(file, HEAD.pack(MAGIC, slot_bytes, _head_sum(slot_bytes)) + bytes(2 * slot_bytes) + log)
        self._map(file, slot_bytes)
        self.write(state)
        new.replace(self._path)

    def _map(self, file: int, slot_bytes: int) -> None:
        self._file, self._slot_bytes = file, slot_bytes
        self._memory = mmap.mmap(file, HEAD.size + 2 * slot_bytes)


def broken(path: Path, what: str) -> SourceError:
    """The error for a file that no run can continue from."""
    return SourceError([Problem(Mark(str(path)), f"{what}; nothing can go on from it: begin anew")])


def _head_sum(slot_bytes: int) -> int:
    return crc32(MAGIC + SUM.pack(slot_bytes))


def _whole_slots(content: bytes | mmap.mmap, slot_bytes: int) -> list[tuple[int, int]]:
    """(generation, offset) of every slot whose check sum is right."""
    found = []
    for begin in (HEAD.size, HEAD.size + slot_bytes):
        (checked,) = SUM.unpack_from(content, begin)
        generation, state_bytes, _, _ = FIELDS.unpack_from(content, begin + SUM.size)
        if state_bytes > slot_bytes - SLOT_HEAD_BYTES:
            continue
        fields_end = begin + SLOT_HEAD_BYTES
        if checked == crc32(content[begin + SUM.size : fields_end + state_bytes]):
            found.append((generation, begin))
    return found
