"""Several cells on one queue: what a job is, what stations can do, and a station's work (`scuhand-bt station`)."""
