"""Rerun recordings, layouts, tables."""
