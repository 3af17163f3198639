"""The simulated cell: a world that conserves mass, the simulated devices in it, and physics that can be replaced."""
