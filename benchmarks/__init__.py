"""Measured claims: each module prints a table and, with --json, writes its figures."""
