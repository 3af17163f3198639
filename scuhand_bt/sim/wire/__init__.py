"""Twins: the other end of each cable, speaking the real protocols on pseudo-terminals and sockets.

Nothing but the wire connects a twin with a driver, so anybody's client can talk to it.
"""
