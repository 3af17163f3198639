"""What `scuhand-bt new device` copies: a driver of every kind that speaks in lines, its twin, and what goes with them.

Each is a device that nobody sells, and passes conformance as it stands; make it yours line by line.
"""
