"""The table of metrics: what binds each id to its algorithm."""
