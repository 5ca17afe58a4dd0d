"""One file per command; the one place that prints and sets exit codes."""
