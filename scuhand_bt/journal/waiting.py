"""The question that a run waits for a person with, by its journal: one rule for all who look at a run."""

from dataclasses import dataclass

from scuhand_bt.events.entry import Event
from scuhand_bt.journal.events import ActionEnded, Answered, Asked
from scuhand_bt.journal.run_events import Ended, Resumed


@dataclass
class Waiting:
    """Told of a run's entries in their order: `asked` is what nobody has answered yet."""

    asked: Asked | None = None
    at: str = ""
    """Since when; ISO 8601 with its offset from UTC."""
    _action: int | None = None

    def take(self, action: int | None, at: str, event: Event | None) -> None:
        """An entry of the action that began with the entry `action`: one that has ended asks nobody any more."""
        match event:
            case Asked():
                self.asked, self.at, self._action = event, at, action
            case Answered() | Ended() | Resumed():
                self.asked = None
            case ActionEnded() if action == self._action:
                self.asked = None
