"""Running: the clocks, the runner that ticks one job's tree, the batch, and the journal."""
