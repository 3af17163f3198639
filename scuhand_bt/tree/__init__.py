"""Workflows: their grammar, the static check of every wire, and the py_trees nodes that they are built into."""
