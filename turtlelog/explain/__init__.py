"""From a log to the reason, by numbers."""
