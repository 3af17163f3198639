"""Carries out a plan: session, batch, the runner that ticks a job's tree, clocks, guards, and resuming."""
