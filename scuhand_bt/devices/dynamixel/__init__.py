"""The servo bus: CRANE-X7's seven joints and the sheet's roller, Dynamixel Protocol 2.0 on one RS-485 line."""
