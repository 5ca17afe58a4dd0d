"""Rerun recordings, their layouts, and the viewer that shows them."""
