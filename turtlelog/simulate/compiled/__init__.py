"""The loop compiled by numba, from the same sources as in Python."""
