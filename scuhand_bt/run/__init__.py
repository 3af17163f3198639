"""Running: the session, the batch, the runner that ticks one job's tree, the clocks, the guards, and resuming."""
