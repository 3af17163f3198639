"""What skills write into a run's journal: one model for each kind of entry, and notes for all that a lab invents.

The engine's own kinds (the run, its jobs and actions, verdicts, questions) are in `scuhand_bt/journal`. An entry's
payload is the model as JSON: what was not set is not written, and what a reader does not know is passed over.
"""
