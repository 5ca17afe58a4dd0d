"""Runs -> differences and tables across gains."""
