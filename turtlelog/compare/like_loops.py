"""Which loops of different laws are alike, so that tables put their metrics beside each other.

Loops of one name stand in the same rows. Others are alike where they control the same (the heading,
the way to the goal, the offset from the line) by the same command, and both answer a step or both
follow a reference. Loops of one law are never mixed: a run has both.
"""

from collections.abc import Iterable, Sequence

from turtlelog.run.loops import RESERVED, ControlLoop, Declaration

_Kind = tuple[str, str, bool]


def order_ids(ids: Iterable[str], declarations: Iterable[Declaration] = ()) -> tuple[str, ...]:
    """Return ids of several laws, each once: loop by loop, then those of the end and the run.

    Loops that are alike in the laws' declarations take turns, metric by metric.
    """
    return tuple(name for group in group_ids(ids, declarations) for name in group)


def group_ids(
    ids: Iterable[str], declarations: Iterable[Declaration] = ()
) -> tuple[tuple[str, ...], ...]:
    """Return the ids in the groups in which `order_ids` puts them."""
    by_loop: dict[str, list[str]] = {}
    for name in dict.fromkeys(ids):
        by_loop.setdefault(name.rpartition(".")[0], []).append(name)
    loops = [loop for loop in by_loop if loop not in RESERVED]
    groups = [*group_loops(loops, declarations), *((name,) for name in by_loop if name in RESERVED)]
    return tuple(_take_turns([by_loop[loop] for loop in group]) for group in groups)


def group_loops(
    names: Iterable[str], declarations: Iterable[Declaration]
) -> tuple[tuple[str, ...], ...]:
    """Return names of loops in groups of those that are alike, groups of one kind in a row."""
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
    """Return ids of several loops metric by metric, in the order in which metrics first come."""
    by_metric: dict[str, list[str]] = {}
    for name in (name for column in columns for name in column):
        by_metric.setdefault(name.rpartition(".")[2], []).append(name)
    return tuple(name for names in by_metric.values() for name in names)
