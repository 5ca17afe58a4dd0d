"""Scenario -> samples -> Run: the plant, the queues, the closed loop."""

from turtlelog.simulate.collect import collect_run, simulate_run
from turtlelog.simulate.controller import Controller, Sample
from turtlelog.simulate.loop import Tick, iterate_ticks
from turtlelog.simulate.queues import CommandQueue
from turtlelog.simulate.turtle import Turtle, round_to_float32

__all__ = [
    "CommandQueue",
    "Controller",
    "Sample",
    "Tick",
    "Turtle",
    "collect_run",
    "iterate_ticks",
    "round_to_float32",
    "simulate_run",
]
