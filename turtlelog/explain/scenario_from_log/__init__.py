"""The scenario that produced a log: identified, simulated again, compared."""
