"""The simulated cell: a world whose mass is conserved, the devices in it, and a replaceable physics."""
