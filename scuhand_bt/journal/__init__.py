"""The journal of a run: written entry by entry, chained by hashes, read back, checked, migrated, exported."""
