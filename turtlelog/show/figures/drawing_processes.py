"""Drawing figures in several processes; what they draw is what one process draws."""

import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from itertools import pairwise
from multiprocessing.connection import Connection
from typing import Final

Draw = Callable[[str], list[bytes]]

_LEAST: Final = 3
"""Figures for each process where their number is not given: a process costs as long as a fifth of
a small figure to fork, and the copies of what it changes as much again."""


def draw_in_processes(draw: Draw, names: Sequence[str], jobs: int | None) -> Iterator[list[bytes]]:
    """Yield what `draw` returns for each name, in their order.

    Each process draws names that stand together: figures of theory load libraries of their own.
    Processes are forked, since libraries take a second of each that is not; where the system
    cannot do that safely, all is drawn in this one. Whatever a process did not draw, because it
    failed or was killed, is drawn here, with its error.

    Args:
        draw: Draws one figure.
        names: Of the figures.
        jobs: Processes, at least 1; None: as many as cores, each with several figures.
    """
    if jobs is None:
        jobs = min(os.cpu_count() or 1, max(len(names) // _LEAST, 1))
    jobs = min(jobs, len(names)) if sys.platform == "linux" else 1
    jobs = max(jobs, 1)
    cuts = [len(names) * part // jobs for part in range(jobs + 1)]
    own, *others = [names[first:after] for first, after in pairwise(cuts)]
    with ExitStack() as ending:
        receivers = [_start(draw, part, ending) for part in others]
        yield from map(draw, own)
        for part, receiver in zip(others, receivers, strict=True):
            drawn = _receive(receiver)
            yield from drawn
            yield from map(draw, part[len(drawn) :])


def _start(draw: Draw, names: Sequence[str], ending: ExitStack) -> Connection:
    """Start a process that draws some figures, and return what it sends them to."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    ending.callback(receiver.close)
    process = context.Process(target=_work, args=(draw, names, sender), daemon=True)
    with warnings.catch_warnings():
        # Newer Pythons warn of threads, such as those of a library that is idle now.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    sender.close()
    ending.callback(process.join)
    ending.callback(process.terminate)
    return receiver


def _work(draw: Draw, names: Sequence[str], sender: Connection) -> None:
    """Draw figures up to the first that fails, and send them all."""
    # A terminal interrupts all processes at once: the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    drawn = []
    with suppress(Exception):
        for name in names:
            drawn.append(draw(name))
    with suppress(OSError):
        sender.send(drawn)


def _receive(receiver: Connection) -> list[list[bytes]]:
    try:
        drawn: list[list[bytes]] = receiver.recv()
    except EOFError:
        return []
    return drawn
