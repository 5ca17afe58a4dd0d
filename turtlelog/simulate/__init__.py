"""Scenario -> samples -> Run: the plant, the queues, the closed loop."""

from turtlelog.simulate.collect import RunCollector, collect_run, simulate_run
from turtlelog.simulate.controller import Controller
from turtlelog.simulate.law_driver import LawDriver, Sample, build_law
from turtlelog.simulate.loop import Tick, iterate_ticks
from turtlelog.simulate.queues import CommandQueue
from turtlelog.simulate.sample_rows import build_samples, pack_sample
from turtlelog.simulate.turtle import Turtle, round_to_float32

__all__ = [
    "CommandQueue",
    "Controller",
    "LawDriver",
    "RunCollector",
    "Sample",
    "Tick",
    "Turtle",
    "build_law",
    "build_samples",
    "collect_run",
    "iterate_ticks",
    "pack_sample",
    "round_to_float32",
    "simulate_run",
]
