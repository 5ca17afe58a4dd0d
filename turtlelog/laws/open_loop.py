"""Open loop: commands over time without feedback, as an excitation or a recorded sequence."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from turtlelog.arithmetic import count_begun
from turtlelog.errors import ParameterError
from turtlelog.laws.base import Goal, LawPart, Row
from turtlelog.run import stop_reasons
from turtlelog.run.loops import Declaration
from turtlelog.run.paths import Path

_TICK_S: Final = 0.016  # one tick of turtlesim [s], the usual sampling period of the controller

_END_OF_SIGNAL: Final = 1

MOST_ROWS: Final = 2500
"""Largest number of rows of a sequence. The three lists of a sequence are part of the scenario's
text. At most 82 bytes a row, they take 200 KiB of the 256 KiB allowed for a recording's scenario.
With one row per tick of 16 ms, this sequence lasts 40 s."""

LARGEST: Final = 1e6
"""Largest magnitude of amplitudes and commands [in their units] and of times [s]: the longest run,
and far below the limits of turtlesim's 32-bit floats."""

_COMMON: Final = {"axis": "turn_rate", "amplitude": 1.0, "start_s": 0.0, "duration_s": 2.4}
_MAXIMUM_LENGTH: Final = {"bit_s": 0.192, "order": 7, "register": 1}

USED_KEYS: Final[Mapping[str, Mapping[str, Any]]] = {
    "impulse": {**_COMMON, "width_s": _TICK_S},
    "step": _COMMON,
    "ramp": _COMMON,
    "prbs": {**_COMMON, **_MAXIMUM_LENGTH, "amplitude": 0.5, "duration_s": 24.384},
    "sequence": {"time_s": (), "speed_m_s": (), "turn_rate_rad_s": ()},
}
"""Keys of each signal with their defaults. In 2.4 s, 150 ticks, a step of 1 rad/s turns less than
half a turn. The default PRBS lasts one period: 127 bits of 12 ticks."""

TAPS: Final[Mapping[int, tuple[int, int]]] = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    9: (9, 5),
    10: (10, 7),
} | {11: (11, 9), 15: (15, 14)}
"""Feedback of shift registers by their order: x^n + x^m + 1 is primitive, so each register runs
through all 2^n - 1 states except 0 (S. W. Golomb, "Shift Register Sequences", 1967). Orders 8, 12,
13 and 14 have no such polynomial of three terms."""

Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Duration = Annotated[float, Meta(ge=1e-9, le=LARGEST)]
"""A duration of at least one nanosecond, the resolution of the clocks [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLoopParameters:
    """Parameters of an open loop. Keys that the signal does not use are refused.

    Times are relative to the first sample. A command is held until the next sample.

    Attributes:
        signal: `impulse`, `step`, `ramp`, `prbs` (a pseudo-random binary sequence of maximum
            length), or `sequence`: the rows of `time_s`, `speed_m_s` and `turn_rate_rad_s`.
        axis: `turn_rate`, `speed` or `both`; `both` have the same amplitude in rad/s and m/s. On
            `both`, a PRBS drives the speed half a period later, so that the two signals hardly
            correlate.
        amplitude: Height of a step; half the height of a PRBS, which alternates between plus and
            minus the amplitude [rad/s or m/s]. Area of an impulse [rad or m]. Slope of a ramp
            [rad/s^2 or m/s^2].
        start_s: Time at which the signal begins [s]. Before this time the command is 0.
        duration_s: Time after `start_s` at which the run ends [s], with the command 0.
        width_s: Width of the impulse, a pulse of the height amplitude / width [s]. The area is
            right if the controller's period is as long.
        bit_s: Time for which a PRBS holds each bit [s].
        order: Bits of the shift register of a PRBS, whose period is 2^order - 1 bits.
        register: State of the shift register at the beginning, 1 to 2^order - 1: it shifts the
            sequence in time.
        time_s: Time at which each row of a sequence begins [s], rising, from 0 or later. A row is
            held until the next row; the run ends with the last row.
        speed_m_s: Speed of each row of a sequence [m/s]. Default: 0.
        turn_rate_rad_s: Turn rate of each row of a sequence [rad/s]. Default: 0.
    """

    signal: Literal["impulse", "step", "ramp", "prbs", "sequence"] = "step"
    axis: Literal["turn_rate", "speed", "both"] | None = None
    amplitude: Number | None = None
    start_s: Annotated[float, Meta(ge=0.0, le=LARGEST)] | None = None
    duration_s: Duration | None = None
    width_s: Duration | None = None
    bit_s: Duration | None = None
    order: int | None = None
    register: int | None = None
    time_s: tuple[float, ...] | None = None
    speed_m_s: tuple[float, ...] | None = None
    turn_rate_rad_s: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        used = USED_KEYS[self.signal]
        for one in fields(self):
            is_used = one.name == "signal" or one.name in used
            if not is_used and getattr(self, one.name) is not None:
                expected = f"a key of the signal {self.signal} ({', '.join(used)})"
                raise ParameterError(f"{one.name}: expected {expected}, found one of another")
        if self.signal == "prbs":
            self._require_register()
        if self.signal == "sequence":
            self._require_rows()

    def complete(self) -> dict[str, Any]:
        """Return the value of every key that the signal uses, given or default."""
        usual = USED_KEYS[self.signal]
        given = {name: getattr(self, name) for name in usual}
        return {name: usual[name] if value is None else value for name, value in given.items()}

    @property
    def begins_s(self) -> float:
        """Time at which the signal begins [s]. Before this time the command is 0."""
        values = self.complete()
        begins_s: float = values["time_s"][0] if "time_s" in values else values["start_s"]
        return begins_s

    def _require_register(self) -> None:
        values = self.complete()
        order, register = values["order"], values["register"]
        if order not in TAPS:
            known = ", ".join(map(str, TAPS))
            raise ParameterError(f"order: expected one of {known}, found {order}")
        most = 2**order - 1
        if not 1 <= register <= most:
            expected = f"1 to {most} at order {order}"
            raise ParameterError(f"register: expected {expected}, found {register}")

    def _require_rows(self) -> None:
        times = self.time_s or ()
        if not 1 <= len(times) <= MOST_ROWS:
            expected = f"1 to {MOST_ROWS:,} rows"
            raise ParameterError(f"time_s: expected {expected}, found {len(times):,}")
        for name in ("speed_m_s", "turn_rate_rad_s"):
            values = getattr(self, name) or ()
            if values and len(values) != len(times):
                expected = f"{len(times):,} values, as time_s has"
                raise ParameterError(f"{name}: expected {expected}, found {len(values):,}")
            _require_numbers(name, values)
        _require_numbers("time_s", times)
        if times[0] < 0.0:
            raise ParameterError(f"time_s: value 1: expected 0 or later, found {times[0]:g}")
        for number, (before, time_s) in enumerate(pairwise(times), start=2):
            # In the nanoseconds in which the clock counts.
            if not _count_ns(time_s) > _count_ns(before):
                expected = f"a time after {before:g}"
                raise ParameterError(f"time_s: value {number}: expected {expected}, found {time_s}")


def _require_numbers(name: str, values: Iterable[float]) -> None:
    for number, value in enumerate(values, start=1):
        if not -LARGEST <= value <= LARGEST:
            expected = f"a number within +-{LARGEST:g}"
            raise ParameterError(f"{name}: value {number}: expected {expected}, found {value:g}")


SEQUENCE, IMPULSE, STEP, RAMP, PRBS = range(5)
"""Numbers of the signals."""

_SIGNALS: Final = ("sequence", "impulse", "step", "ramp", "prbs")


@dataclass(slots=True, kw_only=True)
class CommandSignal:
    """Signal of an open loop, with all times in nanoseconds.

    Attributes:
        kind: `SEQUENCE`, `IMPULSE`, `STEP`, `RAMP` or `PRBS`.
        rows: Number of rows of the table: rows of a sequence, or bits of a PRBS.
        moves_speed: Whether the signal drives the speed.
        moves_turn: Whether the signal drives the turn rate.
        shift: Number of bits by which the speed of a PRBS is delayed.
        excite_phase: Number of the phase in which the signal acts.
        amplitude: Amplitude of the scenario; 0 for a sequence.
        height: Height of the impulse's pulse [m/s or rad/s].
        start_ns: Time at which the signal begins [ns]; 0 for a sequence.
        duration_ns: Duration from `start_ns` to the end [ns]; 0 for a sequence.
        width_ns: Width of the impulse's pulse [ns].
        bit_ns: Duration of a bit of a PRBS [ns].
    """

    kind: int = STEP
    rows: int = 0
    moves_speed: bool = False
    moves_turn: bool = True
    shift: int = 0
    excite_phase: int = 0
    amplitude: float = 0.0
    height: float = 0.0
    start_ns: int = 0
    duration_ns: int = 0
    width_ns: int = 0
    bit_ns: int = 0


@dataclass(slots=True)
class OpenLoopState:
    """State of an open loop: the time of the first sample [ns]; -1 before this sample."""

    first_ns: int = -1


def build_signal(parameters: OpenLoopParameters) -> CommandSignal:
    """Return the signal of an open loop."""
    values = parameters.complete()
    axis = values.get("axis", "both")
    amplitude = values.get("amplitude", 0.0)
    width_s = values.get("width_s", _TICK_S)
    rows = len(values.get("time_s", ()))
    if parameters.signal == "prbs":
        rows = int(2 ** values["order"] - 1)
    return CommandSignal(
        kind=_SIGNALS.index(parameters.signal),
        rows=rows,
        moves_speed=axis != "turn_rate",
        moves_turn=axis != "speed",
        shift=rows // 2 if axis == "both" and parameters.signal == "prbs" else 0,
        excite_phase=int(parameters.begins_s > 0.0),
        amplitude=amplitude,
        height=amplitude / width_s,
        start_ns=_count_ns(values.get("start_s", 0.0)),
        duration_ns=_count_ns(values.get("duration_s", 0.0)),
        width_ns=_count_ns(width_s),
        bit_ns=_count_ns(values.get("bit_s", _TICK_S)),
    )


def build_table(parameters: OpenLoopParameters) -> Sequence[Row]:
    """Return time [ns], speed and turn rate of each row of a sequence, or the bits of a PRBS."""
    values = parameters.complete()
    if parameters.signal == "prbs":
        return [(float(bit),) * 3 for bit in generate_bits(values["order"], values["register"])]
    times = [float(_count_ns(time_s)) for time_s in values.get("time_s", ())]
    none = (0.0,) * len(times)
    speeds, turn_rates = values.get("speed_m_s", ()), values.get("turn_rate_rad_s", ())
    return [*zip(times, speeds or none, turn_rates or none, strict=True)]


def step(settings: Any, state: Any, table: Any, row: Any, time_ns: int) -> tuple[float, float]:
    """Answer one pose with the command for the time of the sample."""
    signal = settings.law
    if state.first_ns < 0:
        state.first_ns = time_ns
    since_ns = time_ns - state.first_ns
    row.phase = signal.excite_phase
    if signal.kind == SEQUENCE:
        return _send_row(signal, table, row, since_ns)
    since_ns -= signal.start_ns
    if since_ns < 0:
        row.phase = 0
        return 0.0, 0.0
    if since_ns >= signal.duration_ns:
        row.stop = _END_OF_SIGNAL
        return 0.0, 0.0
    speed = turn_rate = 0.0
    if signal.moves_speed:
        speed = _compute_value(signal, table, since_ns, signal.shift)
    if signal.moves_turn:
        turn_rate = _compute_value(signal, table, since_ns, 0)
    return speed, turn_rate


def _send_row(signal: Any, table: Any, row: Any, since_ns: int) -> tuple[float, float]:
    """Return the speed and turn rate of the last row that has begun."""
    begun = count_begun(table, signal.rows, since_ns)
    if begun == 0:
        row.phase = 0
        return 0.0, 0.0
    if begun == signal.rows:
        row.stop = _END_OF_SIGNAL
    return table[begun - 1][1], table[begun - 1][2]


def _compute_value(signal: Any, table: Any, since_ns: int, shift: int) -> float:
    amplitude: float = signal.amplitude
    if signal.kind == IMPULSE:
        return signal.height if since_ns < signal.width_ns else 0.0
    if signal.kind == RAMP:
        return amplitude * (since_ns / 1e9)
    if signal.kind == STEP:
        return amplitude
    bit = (since_ns // signal.bit_ns - shift) % signal.rows
    return amplitude if table[bit][0] != 0.0 else -amplitude


def declare(parameters: OpenLoopParameters, goal: Goal | None, path: Path | None) -> Declaration:
    """Return the phases, with `wait` if the signal begins later.

    An open loop has no loops and no goal.
    """
    del goal, path
    phases = ("wait", "excite") if parameters.begins_s > 0.0 else ("excite",)
    return Declaration(phases=dict.fromkeys(phases, ()), uses_goal=False)


def _count_ns(time_s: float) -> int:
    return round(time_s * 1e9)


def generate_bits(order: int, register: int) -> tuple[int, ...]:
    """Return one period of a maximum-length sequence: 2^order - 1 bits, with one more 1 than 0."""
    first, second = TAPS[order]
    bits = []
    for _ in range(2**order - 1):
        bits.append(register & 1)
        fed = ((register >> (order - first)) ^ (register >> (order - second))) & 1
        register = register >> 1 | fed << (order - 1)
    return tuple(bits)


PART: Final = LawPart(
    name="open-loop",
    meaning=(
        "Send commands over time, whatever the robot does: impulse, step, ramp, PRBS or a sequence."
    ),
    Parameters=OpenLoopParameters,
    step=step,
    declare=declare,
    State=OpenLoopState,
    stops=(stop_reasons.END_OF_SIGNAL,),
    counts_samples=(),
    list_unused=lambda _: ("path",),
    prepare=build_signal,
    Numbers=CommandSignal,
    build_table=build_table,
)
