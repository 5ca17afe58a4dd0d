"""The ideal loop."""
