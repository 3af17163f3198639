"""Many dry runs of one recipe: what a plan's odds are, and what they depend on."""
