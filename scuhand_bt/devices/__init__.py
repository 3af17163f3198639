"""Devices: the interfaces that skills see, and the drivers of real ones."""
