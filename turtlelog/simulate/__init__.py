"""Scenario -> samples -> Run: the queues, the closed loop."""

from turtlelog.simulate.closed_loop import Tick, iterate_ticks
from turtlelog.simulate.collect import RunCollector, SampleRows, collect_run, simulate_run
from turtlelog.simulate.controller import Controller
from turtlelog.simulate.law_driver import LawDriver, Sample, build_law, declare_scenario
from turtlelog.simulate.scenario_notes import list_scenario_notes
from turtlelog.simulate.shaping import build_driver
from turtlelog.simulate.transport import CommandQueue

__all__ = [
    "CommandQueue",
    "Controller",
    "LawDriver",
    "RunCollector",
    "Sample",
    "SampleRows",
    "Tick",
    "build_driver",
    "build_law",
    "collect_run",
    "declare_scenario",
    "iterate_ticks",
    "list_scenario_notes",
    "simulate_run",
]
