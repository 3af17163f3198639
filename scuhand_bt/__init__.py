"""scuhand_bt: behaviour trees that scoop and dispense powder on a robot cell."""

__version__ = "0.1.0"
