"""Workflows: their grammar, the static check of every wire, and the py_trees nodes they are built into."""
