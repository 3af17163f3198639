"""The driver of all balances: streams readings on its own thread, and never makes one up.

A reading is what one line of the balance said, at the time its last byte came, and is believed only if it is
plausible (`plausibility`). A line without a unit takes the unit this balance last sent, and one without a sign
of stability is not stable. No tare or zero is ever sent: a dose is the difference of two gross values.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances.conversation import Conversation, Phase
from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, Frame, OutOfRange, Weight
from scuhand_bt.devices.balances.plausibility import CONFIRMATIONS, Misfit, Plausibility, misfit
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.devices.serial_link import REOPEN_S, SPOILT, Framing, SerialLink, Silence
from scuhand_bt.failures import Code, SkillFailed

ADJUSTMENT_S = 300.0
"""How long an internal adjustment may keep the balance silent."""
UNDERLOAD = (
    "it is in underload: put its pan in place. If it was switched on with something on the pan, clear the pan, and "
    "switch it off and on"
)
AVERAGED = 5
"""Readings of one stable mean."""
MISFITS = 5
"""Lines of another form than robot/cell.yaml says, one after the other, which no noise makes."""


@dataclass(frozen=True, slots=True)
class _Trouble:
    """Why there is no reading. Without a code it only explains a silence, should one follow."""

    code: str
    detail: str
    adjusting: bool = False


class SerialBalance:
    """A balance on a serial port, in one of the dialects; meets `devices.interfaces.Balance`.

    `others` are the dialects it might speak by mistake.
    """

    def __init__(
        self,
        spec: BalanceSpec,
        dialect: Dialect,
        clock: Clock,
        others: Iterable[Dialect] = (),
        reopen_s: float = REOPEN_S,
    ) -> None:
        self.spec = spec
        self.news = Signal()
        self.latest: Reading | None = None
        """The last reading; None before the first one and while the balance is lost."""
        self.on_reading: Callable[[Reading], None] | None = None
        self.identity = ""
        """What the balance answered when asked who it is; empty where it did not."""
        self.misfit: Misfit | None = None
        """How what it shows again and again differs from robot/cell.yaml; no reading is given out then."""
        self.lines = 0
        """Lines that have come since the port was opened."""
        self._dialect = dialect
        self._others = [other for other in others if other is not dialect]
        self._clock = clock
        framing = Framing(spec.options.baud or dialect.framing.baud, spec.options.bits or dialect.framing.bits)
        self._link = SerialLink(spec.port, framing, self, reopen_s)
        self._talk = Conversation(dialect, self._link.write, self._link.discard_input, spec.period_s)
        self._unit = ""
        self._plausibility = Plausibility(spec)
        self._misfits = 0
        self._broken = 0
        self._answer_length = 0
        self._unread = b""
        """The last line that said nothing in this dialect, since one that did."""
        self._silence = Silence()
        self._trouble: _Trouble | None = None

    @property
    def is_stopped(self) -> bool:
        return True

    def stop(self) -> None:
        """Nothing of a balance moves."""

    @property
    def fault(self) -> SkillFailed | None:
        """It is lost: its port has gone, or it has been silent for too long. A load beyond its range may be a hand."""
        trouble = self._trouble
        return self._failure(trouble) if trouble is not None and trouble.code == Code.DEVICE_LOST else None

    @property
    def says_who_it_is(self) -> bool:
        """Whether there is a question for that in its dialect."""
        return bool(self._dialect.identify)

    @property
    def discarded(self) -> int:
        """Lines since the port was opened that were no reading: broken, spoilt, or not believed."""
        return self._broken + self._plausibility.discarded

    def open(self) -> None:
        """Open the port and begin to read; SkillFailed device.lost if it cannot be opened."""
        self._link.start()

    def close(self) -> None:
        """End the reading thread and close the port."""
        self._link.close()

    def next_reading(self, timeout_s: float | None = None) -> Steps[Reading]:
        """Wait for the next reading, for the spec's `awaited_s` if for no other time.

        SkillFailed device.lost if none comes, balance.overload.

        A balance whose line is held back is not silent: it is waited for until that line is confirmed, or not.
        """
        timeout_s = self.spec.awaited_s if timeout_s is None else timeout_s
        deadline_s = self._clock.now_s + timeout_s
        held_until_s = deadline_s + CONFIRMATIONS * self.spec.period_s
        seen = self.latest
        while True:
            if self._plausibility.is_holding:
                deadline_s = held_until_s
            wake = Wake.on(self.news, deadline_s)  # made before looking, so that no news falls between
            latest, trouble = self.latest, self._trouble
            if latest is not None and latest is not seen:
                return latest
            if trouble is not None and trouble.code:
                raise self._failure(trouble)
            if self._clock.now_s >= deadline_s:
                why = f": {trouble.detail}" if trouble else ""
                raise SkillFailed(Code.DEVICE_LOST, f"no reading from {self._name} for {timeout_s:g} s{why}")
            yield wake

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        """Average successive readings that the balance itself calls stable.

        SkillFailed balance.unstable if there are not enough in time, balance.overload, device.lost.
        """
        deadline_s = self._clock.now_s + timeout_s
        reading = None
        stable: list[Reading] = []
        while len(stable) < AVERAGED:
            try:
                reading = yield from self.next_reading(deadline_s - self._clock.now_s)
            except SkillFailed:
                if reading is None or self._clock.now_s < deadline_s:
                    raise
                detail = f"{self._name} was not stable within {timeout_s:g} s"
                raise SkillFailed(Code.BALANCE_UNSTABLE, detail) from None
            stable = [*stable, reading] if reading.stable else []
        return stable_mean(stable, self.spec.readability_mg)

    # From here on: called from the link's thread.

    def opened(self) -> None:
        """Begin the conversation."""
        self._silence.broken()
        self._unread = b""
        self._unit = self.spec.options.unit or ""  # it may be another balance now, in another unit
        self._plausibility = Plausibility(self.spec)
        self.misfit = None
        self._misfits = self._broken = self.lines = 0
        self._talk.begin()

    def line(self, raw: bytes) -> None:
        """Take one line of the balance."""
        now_s = self._clock.now_s
        self.lines += 1
        frame = self._dialect.parse(raw)
        if not isinstance(frame, Weight):
            for other in self._others:
                if isinstance(other.parse(raw), Weight):
                    detail = f"it speaks {other.name}; change `driver` in robot/cell.yaml, or the balance's menu"
                    self._say(_Trouble(Code.DEVICE_LOST, detail))
                    return
        if frame is None:
            self._unread = raw
            self._broken += 1
            if len(raw) == self._answer_length:
                self._talk.misheard()
            return  # noise, or half a line; if that is all there is, it is said with the silence
        self._silence.broken()
        self._unread = b""
        identifying = self._talk.state is Phase.IDENTIFYING
        if not self._talk.heard(frame):
            return
        if isinstance(frame, Answer):
            self.identity = frame.text if identifying else self.identity
        elif isinstance(frame, Weight):
            self._weighed(frame, raw, now_s)
        else:
            self._explained(frame)

    def idle(self) -> None:
        """Speak when it is time to, and notice silence."""
        adjusting = self._trouble is not None and self._trouble.adjusting
        patience_s = ADJUSTMENT_S if adjusting else self.spec.lost_after_s
        if self._silence.seconds > patience_s and self.fault is None:
            self._say(_Trouble(Code.DEVICE_LOST, self._why_silent()))
        self._talk.go_on(patience_s)

    def lost(self, why: str) -> None:
        """The port has gone."""
        self._say(_Trouble(Code.DEVICE_LOST, why))

    def _weighed(self, weight: Weight, raw: bytes, now_s: float) -> None:
        self._answer_length = len(raw)
        unit = weight.unit or self._unit
        if not unit:
            shown = "it shows no unit, and was not stable before"
            self._say(_Trouble("", f"{shown}; set it to g, or give `options: {{unit: g}}` in robot/cell.yaml"))
            return
        if (odd := misfit(weight, unit, self.spec)) is not None:
            self._broken += 1
            self._misfits += 1
            self._mistrust(odd, is_certain=self._misfits >= MISFITS)
            return
        self._misfits = 0
        self._unit = unit
        value_mg = weight.milligrams(unit)
        assert value_mg is not None
        line, reading = self._plausibility.judge(Reading(value_mg, weight.stable, now_s, weight.unit, raw))
        if self.on_reading is not None:
            self.on_reading(line)
        if reading is not None:
            self._believe(reading)

    def _believe(self, reading: Reading) -> None:
        if (coarse := self._plausibility.coarser(reading)) is not None:
            self._mistrust(coarse, is_certain=True)
        elif (beyond := self._plausibility.beyond(reading)) is not None:
            self._explained(beyond)
        else:
            self.latest, self._trouble, self.misfit = reading, None, None
            self.news.fire()

    def _mistrust(self, odd: Misfit, *, is_certain: bool) -> None:
        """Say what is odd: one such line may be noise, and then only explains a silence."""
        if is_certain:
            self.misfit = odd
        if is_certain or self._trouble is None:
            self._say(_Trouble(Code.DEVICE_LOST if is_certain else "", str(odd)))

    def _explained(self, frame: Frame) -> None:
        if isinstance(frame, OutOfRange):
            detail = "it is loaded beyond its maximum" if frame.above else UNDERLOAD
            self._say(_Trouble(Code.BALANCE_OVERLOAD, detail))
        elif isinstance(frame, Busy):
            self._say(_Trouble("", f"it is busy ({frame.detail})", frame.adjusting))

    def _why_silent(self) -> str:
        if not self._unread:
            return "it is silent; is it switched on, and are speed and parity as in robot/cell.yaml?"
        if SPOILT in self._unread:
            return "its bytes fail the parity check; correct `bits` in robot/cell.yaml, or look at its cable"
        shown = repr(self._unread[:40].strip())[2:-1]
        return (
            f"it sends lines that are not in the format {self._dialect.name}, such as '{shown}'; set the balance to "
            "that format, or correct `driver`, speed and parity in robot/cell.yaml"
        )

    def _failure(self, trouble: _Trouble) -> SkillFailed:
        return SkillFailed(trouble.code, f"{self._name}: {trouble.detail}")

    def _say(self, trouble: _Trouble) -> None:
        if trouble.code == Code.DEVICE_LOST:
            self.latest = None  # what it weighed before is no news of now
        self._trouble = trouble
        self.news.fire()

    @property
    def _name(self) -> str:
        return f"the {self._dialect.name} balance on {self.spec.port}"


def stable_mean(readings: Sequence[Reading], readability_mg: float) -> StableMean:
    """Mean of stable readings; its uncertainty is their scatter and the rounding of each, in quadrature."""
    values = [reading.value_mg for reading in readings]
    scatter_mg = statistics.stdev(values) / math.sqrt(len(values))
    rounding_mg = readability_mg / math.sqrt(12)
    mean_mg = statistics.fmean(values)
    return StableMean(mean_mg, math.hypot(scatter_mg, rounding_mg), readings[-1].time_s, tuple(readings))
