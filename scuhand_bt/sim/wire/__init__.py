"""Device twins: the other end of each cable, speaking the real protocols on pseudo-terminals and sockets.

Only the wire connects a twin with a driver, so any other client can talk to it too.
"""
