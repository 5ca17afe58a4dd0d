"""Assertions on recordings."""
