"""Assembly of the loop's functions from parts; effects at one place are chained in order.

Arguments are passed by parameter name. The texts that are compiled here contain only such calls,
the same for ordinary Python and compiled code.
"""

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from inspect import signature
from types import FunctionType
from typing import Any, Final, NamedTuple, get_args

from turtlelog.errors import LawError
from turtlelog.parts import Effect, Place, PlantPart

PLACES: Final[tuple[Place, ...]] = get_args(Place)

OF_TICKS: Final = frozenset({"lose_pose", "sense", "pose_travel", "push"})
"""Places whose events are poses; at all other places, events are samples."""

_AT_PLACES: Final = {
    "settings": "settings",
    "state": "state.{effect}",
    "drawn": "rows.{drawn}[number].{stream}",
    "value": "value",
    "dt_s": "extra",
    "time_ns": "extra",
    "period_ns": "settings.scene.period_ns",
}
_OF_LAW: Final = {
    "settings": "settings",
    "state": "state.law",
    "table": "rows.table",
    "pieces": "rows.pieces",
    "row": "row",
    "time_ns": "time_ns",
    "pose": "pose",
}
"""Arguments of a law's step by the names of its parameters."""

Function = Callable[..., Any]


class Parts(NamedTuple):
    """The functions that the loop calls: of the law, of the plant, and of the effects by place."""

    decide: Function
    record: Function
    hold: Function
    apply_push: Function
    move: Function
    read: Function
    lose_pose: Function
    pose_travel: Function
    sense: Function
    shape: Function
    limit: Function
    lose_command: Function
    command_travel: Function
    repeat: Function
    push: Function
    next_push: Function


def name_stream(effect: Effect, place: Place) -> str:
    """Return the name of a stream's rows of random numbers."""
    return f"{effect.name}_{place}"


def bind_parts(
    plant: PlantPart, decide: Function, record: Function, effects: Iterable[Effect]
) -> Parts:
    """Return the functions of a loop: one for each place, from the effects that act there."""
    chosen = tuple(effects)
    return Parts(
        decide=decide,
        record=record,
        hold=plant.hold,
        apply_push=plant.push,
        move=plant.move,
        read=plant.read,
        **{place: _chain(place, chosen) for place in PLACES},
    )


@lru_cache(maxsize=256)
def _chain(place: Place, effects: tuple[Effect, ...]) -> Function:
    """Return a function that applies the effects at a place to a value, in order."""
    lines, names = [], {}
    for effect in effects:
        if place not in effect.actions:
            continue
        drawn = "drawn_ticks" if place in OF_TICKS else "drawn_samples"
        words = {"effect": effect.name, "stream": name_stream(effect, place), "drawn": drawn}
        step = effect.actions[place].step
        lines.append(f"    value = do_{effect.name}({_list_arguments(step, _AT_PLACES, **words)})")
        names[f"do_{effect.name}"] = step
    head = f"def {place}(settings, state, rows, number, extra, value):"
    return compile_text(place, [head, *lines, "    return value"], names)


@lru_cache(maxsize=64)
def bind_step(step: Function) -> Function:
    """Return the function that calls the step of a law that is a part.

    Raises:
        LawError: If the step has a parameter that the loop does not know.
    """
    if unknown := [name for name in list_parameters(step) if name not in _OF_LAW]:
        code = step.__code__
        place = f"{code.co_filename}, line {code.co_firstlineno}: {step.__qualname__}"
        raise LawError(
            f"{place}: expected parameters among {', '.join(_OF_LAW)}, found {unknown[0]}"
        )
    call = f"    return step({_list_arguments(step, _OF_LAW)})"
    head = "def decide(settings, state, rows, row, time_ns, pose):"
    return compile_text("decide", [head, call], {"step": step})


@lru_cache(maxsize=64)
def bind_states(states: tuple[str, ...]) -> Function:
    """Return a function that records the states of a law and returns whether all are finite."""
    lines = ["def record(state, rows, number):"]
    if not states:
        lines.append("    return True")
    else:
        lines.append("    row = begin_row(rows.states, rows.new[0].states, number)")
        lines += [f"    row.{name} = state.{name}" for name in states]
        known = " and ".join(f"math.isfinite(state.{name})" for name in states)
        lines.append(f"    return {known}")
    from turtlelog.arithmetic import begin_row

    return compile_text("record", lines, {"begin_row": begin_row, "math": math})


def _list_arguments(step: Function, known: dict[str, str], **words: str) -> str:
    names = list_parameters(step)
    return ", ".join(known[name].format(**words) for name in names)


def list_parameters(step: Function) -> list[str]:
    """Return the parameter names of a step."""
    return [*signature(step).parameters]


def compile_text(name: str, lines: list[str], names: dict[str, Any]) -> Function:
    """Return the function in source lines; it calls other functions by name."""
    scope: dict[str, Any] = {**names, "__name__": __name__}
    text = "\n".join(lines)
    exec(compile(text, f"<{name} of the loop>", "exec"), scope)
    made: FunctionType = scope[name]
    made.source = text  # type: ignore[attr-defined]
    return made
