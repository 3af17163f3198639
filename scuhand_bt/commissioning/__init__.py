"""Commissioning: a new cell is led through, step by step, to its first dose (docs/commissioning.md)."""
