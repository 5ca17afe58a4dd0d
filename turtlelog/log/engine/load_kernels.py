"""The compiled loops of reading, `kernels`, and what they save."""

from functools import partial
from importlib import import_module
from typing import Final

from turtlelog.compiled_loops import CompiledLoops, is_kept

COST_S: Final = 0.7
"""What numba's import and the loops take from their cache [s]."""

FIRST_S: Final = 3.0
"""What they take before they are in it [s]: four times as long, in turns."""

WALKED_S: Final = 1e-7
"""What they save of a message that no index names [s]: 0.9e-7 in chunks, 1.6e-7 without."""

INDEXED_S: Final = 4e-8
"""What they save of a message that an index names [s]: of a million some 30 ms, of our own 40."""

_MODULE: Final = "turtlelog.log.engine.kernels"

KERNELS: Final = CompiledLoops(
    partial(import_module, _MODULE), partial(is_kept, _MODULE), cost_s=COST_S, first_s=FIRST_S
)
