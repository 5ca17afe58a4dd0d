"""Equivalent loops of different laws, whose metrics are put next to each other in tables.

Loops with the same name share rows. Other loops are equivalent if they control the same quantity
with the same command. Quantities are the heading, the distance to the goal and the offset from the
line. In addition, both must answer a step, or both follow a reference. Loops of one law are never
merged, because a run has both.
"""

from collections.abc import Iterable, Sequence

from turtlelog.run.loops import RESERVED, ControlLoop, Declaration

_Kind = tuple[str, str, bool]


def order_ids(ids: Iterable[str], declarations: Iterable[Declaration] = ()) -> tuple[str, ...]:
    """Return the ids of several laws without duplicates: loop by loop, then end and run.

    Equivalent loops in the laws' declarations alternate, metric by metric.
    """
    return tuple(name for group in group_ids(ids, declarations) for name in group)


def group_ids(
    ids: Iterable[str], declarations: Iterable[Declaration] = ()
) -> tuple[tuple[str, ...], ...]:
    """Return the ids in groups, in the order of `order_ids`."""
    by_loop: dict[str, list[str]] = {}
    for name in dict.fromkeys(ids):
        by_loop.setdefault(name.rpartition(".")[0], []).append(name)
    loops = [loop for loop in by_loop if loop not in RESERVED]
    groups = [*group_loops(loops, declarations), *((name,) for name in by_loop if name in RESERVED)]
    return tuple(_take_turns([by_loop[loop] for loop in group]) for group in groups)


def group_loops(
    names: Iterable[str], declarations: Iterable[Declaration]
) -> tuple[tuple[str, ...], ...]:
    """Return the names of equivalent loops in groups, with groups of one kind side by side."""
    declared = tuple(dict.fromkeys(declarations))
    kinds: dict[str, _Kind] = {}
    for loop in (loop for declaration in declared for loop in declaration.loops):
        kinds.setdefault(loop.name, _find_kind(loop))
    together = [{loop.name for loop in declaration.loops} for declaration in declared]
    groups: list[list[str]] = []
    for name in names:
        kind = kinds.get(name)
        alike = [group for group in groups if kind is not None and kinds.get(group[0]) == kind]
        for group in alike:
            if not any(name in law and not law.isdisjoint(group) for law in together):
                group.append(name)
                break
        else:
            place = groups.index(alike[-1]) + 1 if alike else len(groups)
            groups.insert(place, [name])
    return tuple(map(tuple, groups))


def _find_kind(loop: ControlLoop) -> _Kind:
    is_way = loop.signal in ("along_track", "distance")
    return ("way" if is_way else loop.signal, loop.command, loop.moves)


def _take_turns(columns: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the ids of several loops metric by metric, in order of first appearance."""
    by_metric: dict[str, list[str]] = {}
    for name in (name for column in columns for name in column):
        by_metric.setdefault(name.rpartition(".")[2], []).append(name)
    return tuple(name for names in by_metric.values() for name in names)
