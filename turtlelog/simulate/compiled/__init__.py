"""The closed loop, compiled by numba.

The files, their steps, their order and their names are those of the interpreted loop. Each
operation on floats is its own, in its order, so that the numbers are the same bit for bit. What the
interpreted loop would refuse ends the run with `has_failed`.

Queues are stretches of arrays, from a `first` to an `end` that only grow.
"""
