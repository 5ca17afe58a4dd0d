"""Identification of the scenario that produced a log, and comparison of its re-simulation."""
