"""The cell as skills see it: its devices, what it is believed to hold, its named places, and the dose loop."""
