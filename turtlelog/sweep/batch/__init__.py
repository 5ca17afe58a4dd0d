"""Simulation and measurement of many scenarios in compiled code, without trajectories."""
