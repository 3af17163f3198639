"""Devices: the interfaces that skills see, the cell that holds them, and the drivers of real ones."""
