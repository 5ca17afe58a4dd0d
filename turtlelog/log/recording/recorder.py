"""Live recording: a file that is readable up to the last second."""

import struct
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from math import isnan, nan
from os import fstat
from os.path import samestat
from pathlib import Path
from typing import Any, BinaryIO, Final, Self

import numpy as np
from mcap.opcode import Opcode

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log.engine.blocks import ChunkRows
from turtlelog.log.engine.cdr import ENCAPSULATION, encode_message
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.records import FRONT, RECORD
from turtlelog.log.file_access import create_file, mark_live, name_write_error
from turtlelog.log.mcap_writer import LIVE_CHUNK_BYTES, McapFile
from turtlelog.log.recording import topics
from turtlelog.log.recording.head import FORMAT_VERSION, HEAD, SCENARIO_FILE, Head, format_head
from turtlelog.log.recording.run_writer import describe_pose, tabulate_event
from turtlelog.run import CUT_SHORT, SourceKind
from turtlelog.run.loops import DONE, PAUSE, Declaration
from turtlelog.run.stop_reasons import INTERRUPTED
from turtlelog.scenario import Scenario, format_scenario, resolve_scenario
from turtlelog.simulate import SampleRow, Tick, declare_scenario, find_software
from turtlelog.stop_signals import exit_on_terminate, hold_stop

_FLUSH_S: Final = 1.0
"""Time after which a chunk is written even if it is not full, by the wall clock [s]."""

_INTERRUPTIONS: Final = (KeyboardInterrupt, SystemExit)
_NO_NOTES: Final[Mapping[str, str]] = {}


class Recorder:
    """Recorder of the ticks of a running loop in a new file, visible under its name at once.

    Ticks are buffered until 64 KiB are full or a second has passed, and then written to the
    operating system as one self-contained chunk. A killed process therefore loses about the last
    second; a power failure may lose more. Nothing runs in the background: if the loop blocks,
    buffered ticks are written with the next tick.

    As a context manager, the recorder finishes the file at exit, also after Ctrl-C, SIGTERM, SIGHUP
    or SIGQUIT. An existing file is refused. If the file is deleted, moved or replaced, the
    recording ends with the next chunk, because later data would be lost.
    """

    def __init__(
        self,
        path: str | Path,
        scenario: Scenario,
        *,
        flush_s: float = _FLUSH_S,
        create: Callable[[Path], BinaryIO] = create_file,
    ) -> None:
        """Create the file and write the metadata of the scenario.

        Args:
            path: The file, which must not exist.
            scenario: Scenario that runs.
            flush_s: Longest time that a tick is buffered [s].
            create: Function that creates the file, like `create_file`.

        Raises:
            LogError: If the file exists or cannot be written.
            ScenarioError: If the law cannot be loaded or may not run.
            LawError: If the law's declaration is invalid.
        """
        if isinstance(make_path(path), RemotePath):
            raise LogError(f"{make_path(path)}: expected a local file to record live, found a URL")
        scenario = resolve_scenario(scenario)
        self._path, self._scenario, self._flush_s = Path(path), scenario, flush_s
        self._declaration = declare_scenario(scenario)
        self._records = TickRecords(scenario, self._declaration)
        self._ticks: list[Tick] = []
        self._size, self._oldest_s = 0, 0.0
        self._safe_ns: int | None = None
        self._stop_reason: str | None = None
        self._exits, self._error_before = ExitStack(), sys.exception()
        with ExitStack() as undoing:
            with hold_stop():
                self._stream = self._create(create)
                undoing.callback(self._discard)
                self._place = self._path.absolute()  # the process may change its folder
                mark_live(self._stream)
                self._file, self._is_open = McapFile(self._stream), True
                with self._guard():
                    self._file.begin()
                    self._add_head(_NO_NOTES)
                    self._file.add_attachment(SCENARIO_FILE, format_scenario(scenario).encode())
            undoing.pop_all()

    def __enter__(self) -> Self:
        self._exits.enter_context(exit_on_terminate())
        return self

    def __exit__(self, *_: object) -> None:
        with self._exits:
            self.close()

    def receive(self, tick: Tick) -> None:
        """Record a tick.

        If the file cannot be written, it is closed, and readable up to that point.
        """
        if not self._is_open:
            raise LogError(f"{self._path}: expected a recording in progress, found a closed one")
        now_s = time.monotonic()
        if not self._ticks:
            self._oldest_s = now_s
        self._ticks.append(tick)
        self._size += measure_tick(tick)
        if self._size >= LIVE_CHUNK_BYTES or now_s - self._oldest_s >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Write buffered ticks to the operating system.

        Raises:
            LogError: As for `receive`, or if the file was moved, deleted or replaced.
        """
        self._write_ticks()
        loss = self._find_loss() if self._is_open else None
        if loss is not None:
            self._give_up(f"the file was {loss}")
            raise self._describe_loss(loss)

    def close(self, notes: Mapping[str, str] = _NO_NOTES) -> None:
        """Finish the file. A second call does nothing.

        A recording closed by Ctrl-C or an exit gets the stop reason `interrupted`.

        Args:
            notes: Notes of the run, as in `Run`.
        """
        with hold_stop():
            self._write_ticks()
            if not self._is_open:
                return
            error = sys.exception()
            if error is not self._error_before and isinstance(error, _INTERRUPTIONS):
                self._stop_reason = self._stop_reason or INTERRUPTED
            with self._guard():
                self._add_head(notes)
                self._file.finish()
            self._is_open = False
            loss = self._find_loss()
            try:
                self._stream.close()
            except OSError as err:
                expected = "expected the system to keep the file"
                raise LogError(f"{self._path}: {expected}, found: {err.strerror}") from err
            if loss is not None:
                raise self._describe_loss(loss)

    def _write_ticks(self) -> None:
        if self._is_open and self._ticks:
            with self._guard():
                self._file.add_chunk(self._records.encode(self._ticks))
                self._safe_ns = self._ticks[-1].time_ns
                self._stop_reason = self._ticks[-1].stop_reason or self._stop_reason
                self._ticks, self._size = [], 0

    def _find_loss(self) -> str | None:
        """Return what happened to the file if its name no longer leads to it; else None."""
        try:
            own = fstat(self._stream.fileno())
            with suppress(FileNotFoundError, NotADirectoryError):
                if samestat(own, self._place.stat()):
                    return None
        except OSError:  # not a regular file, or a folder that is no longer readable
            return None
        return "moved" if own.st_nlink else "deleted"

    def _describe_loss(self, loss: str) -> LogError:
        until = f"{(self._safe_ns or 0) / 1e9:.3f} s"
        rest = f"its {until} are lost" if loss == "deleted" else f"{until} are safe where it is now"
        return LogError(f"{self._path}: expected a file that stays, found it {loss}: {rest}")

    def _discard(self) -> None:
        with suppress(OSError):
            self._stream.close()
        self._path.unlink(missing_ok=True)

    def _create(self, create: Callable[[Path], BinaryIO]) -> BinaryIO:
        try:
            format_scenario(self._scenario).encode()
            return create(self._path)
        except FileExistsError as err:
            raise LogError(
                f"{self._path}: expected a new file, found one: a live recording replaces nothing"
            ) from err
        except OSError as err:
            raise LogError(f"{self._path}: cannot be written: {err.strerror or err}") from err
        except UnicodeEncodeError as err:
            raise name_write_error(self._path, err) from err

    def _add_head(self, notes: Mapping[str, str]) -> None:
        heading_rad = self._scenario.goal.heading_rad if self._declaration.uses_goal else None
        head = Head(
            format_version=FORMAT_VERSION,
            source=SourceKind.SIMULATION.describe(),
            name=self._scenario.name,
            stop_reason=self._stop_reason,
            goal_heading_rad=heading_rad,
            absent=(),
            nan_columns=self._records.nan_columns,
            more_topics=self._records.more_topics,
            declaration=self._declaration,
            simulated_by=find_software(self._scenario.law.kind),
            notes=notes,
        )
        self._file.add_metadata(HEAD, format_head(head))

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Delay signals until a write ends. If the write fails, close the readable file."""
        try:
            with hold_stop():
                yield
        except (OSError, UnicodeEncodeError, struct.error) as err:
            reason = (isinstance(err, OSError) and err.strerror) or str(err)
            self._give_up(reason)
            safe_ns = self._safe_ns
            safe = "its head alone is" if safe_ns is None else f"{safe_ns / 1e9:.3f} s are"
            reason = f"no room for the recording: {reason}: {safe} safe"
            raise LogError(f"{self._path}: {reason}") from err

    def _give_up(self, reason: str) -> None:
        """Remove an incomplete record, finish the file if there is room, and close it."""
        self._is_open = False
        try:
            self._file.cut_back()
            self._add_head({"recording_failed": reason})
            self._file.finish()
        except OSError:
            with suppress(OSError):
                self._file.cut_back()
        with suppress(OSError):
            self._stream.close()


_MESSAGE: Final = int(Opcode.MESSAGE)


_FIXED: Final = (
    *(topics.POSE, topics.POSE64, topics.SENSED, topics.SENSED64),
    *(topics.CONTROL, topics.SHAPED, topics.COMMAND, topics.REFERENCE64),
)
_STRUCTS: Final = {topic: topics.build_packer(topic) for topic in _FIXED}
_POSE_SIZE, _POSE64_SIZE, _CONTROL_SIZE, _COMMAND_SIZE = (
    _STRUCTS[topic].size for topic in (topics.POSE, topics.POSE64, topics.CONTROL, topics.COMMAND)
)


def measure_tick(tick: Tick) -> int:
    """Return the approximate size of a tick's messages [bytes]."""
    size = _POSE_SIZE + _COMMAND_SIZE * len(tick.published) + FRONT.size * len(tick.events)
    size += 0 if isnan(tick.row.sensed_x_m) else _POSE_SIZE + _POSE64_SIZE
    size += sum(FRONT.size + 8 * len(states) for states in tick.states)
    for sample in tick.computed:
        size += _CONTROL_SIZE + (0 if isnan(sample.shaped_speed_m_s) else _COMMAND_SIZE)
        size += 0 if isnan(sample.reference_x_m) else topics.REFERENCE_BYTES
    return size


@dataclass(slots=True, eq=False)
class _Messages:
    number: int  # number of the topic's channel
    pack: Callable[..., bytes]  # packs a record, if the type has a fixed size
    length: int  # of such a record, as in its length field
    count: int = 0  # messages so far
    entries: list[int] = field(default_factory=list)
    """Log times and offsets of the messages in the present chunk, alternating."""


class TickRecords:
    """Encoder of ticks as numbered messages, like `build_messages` for a complete run.

    If the law blocks and declares the end of its phase, the message of the pause comes with the
    sample that begins the pause. Otherwise the next sample shows the pause, and the message gets
    the earlier time. Poses are recorded in double precision if the scenario requests it.

    Attributes:
        more_topics: Optional topics of this recording.
    """

    def __init__(self, scenario: Scenario, declaration: Declaration) -> None:
        goal, kind = scenario.goal, scenario.law.kind
        self._goal = (goal.x_m, goal.y_m, goal.heading_rad) if declaration.uses_goal else None
        self._is_exact = scenario.loop.pose_precision == "float64"
        is_sensed = scenario.has_action("sense", "lose_pose")
        more = {topics.SENSED.name: is_sensed, topics.SHAPED.name: scenario.has_action("shape")}
        self.more_topics = frozenset(name for name, is_there in more.items() if is_there)
        listed = topics.list_topics(declaration, kind, self.more_topics)
        definitions = topics.define_types(declaration, kind)
        named = [(topic.name, topic.schema) for topic in listed]
        self._channels = topics.describe_topics(named, definitions)
        self._messages: dict[str, _Messages] = {}
        for number, topic in enumerate(listed, start=1):
            packer = _STRUCTS.get(topic, FRONT)
            if topic.name == topics.LAW_STATE:
                packer = topics.build_packer(topic, definitions)
            length = packer.size - RECORD.size
            self._messages[topic.name] = _Messages(number=number, pack=packer.pack, length=length)
        self._pose, self._pose64, self._control, self._command = (
            self._messages[topic.name]
            for topic in (topics.POSE, topics.POSE64, topics.CONTROL, topics.COMMAND)
        )
        self._sensed, self._sensed64, self._shaped, self._reference64 = (
            self._messages.get(topic.name)
            for topic in (*topics.OF_SENSING, topics.SHAPED, topics.REFERENCE64)
        )
        self._states = self._messages.get(topics.LAW_STATE)
        self._phases = declaration.phase_names
        self._phase: int | None = None
        self._lacking: set[str] = set()
        self._has_samples = self._has_world = False
        self._is_paused = self._is_blocked = False
        self._sample_ns = 0
        self._records = bytearray()

    @property
    def nan_columns(self) -> frozenset[str]:
        """Columns of the run so far that are None, and NaN in the messages."""
        worldless = {"world_velocity_m_s"} if self._has_samples and not self._has_world else set()
        return frozenset(f"samples.{name}" for name in self._lacking | worldless)

    def encode(self, ticks: Iterable[Tick]) -> ChunkRows:
        """Return the messages of the next ticks, at least one tick."""
        for tick in ticks:
            self._add_pose(tick)
            for number, sample in enumerate(tick.computed):
                self._add_sample(sample, tick.states[number] if tick.states else ())
            for sample in tick.published:
                values = sample.speed_m_s, 0.0, 0.0, 0.0, 0.0, sample.turn_rate_rad_s
                self._add(self._command, sample.published_ns, sample.sequence, *values)
            for sample in tick.computed:
                self._follow_phase(sample)
            if tick.stop_reason is not None and self._phase is not None:
                later_ns = [sample.time_ns for sample in tick.computed]
                later_ns += [sample.published_ns for sample in tick.published]
                self._end_phase(max([tick.time_ns, *later_ns]), tick.stop_reason)
            for event in tick.events:
                self._add_varied(topics.EVENT, event.time_ns, tabulate_event(event))
        return self._collect()

    def _add_pose(self, tick: Tick) -> None:
        time_ns, row, number = tick.time_ns, tick.row, self._pose.count
        self._pose.count = number + 1
        if not number and self._goal is not None:
            self._add_varied(topics.GOAL, time_ns, describe_pose(time_ns, *self._goal))
        values = row.x_m, row.y_m, row.heading_rad
        self._add(self._pose, time_ns, number, *values, row.speed_m_s, row.turn_rate_rad_s)
        if self._is_exact:
            self._add(self._pose64, time_ns, number, *values)
        if isnan(row.sensed_x_m):
            return
        values = row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad
        if self._sensed is not None:  # a sensor gives no velocity
            self._add(self._sensed, time_ns, number, *values, nan, nan)
        if self._sensed64 is not None and self._is_exact:
            self._add(self._sensed64, time_ns, number, *values)

    def _add_sample(self, sample: SampleRow, states: tuple[float, ...]) -> None:
        time_ns, row, sequence = sample.time_ns, topics.LIST_SAMPLE(sample), sample.sequence
        self._add(self._control, time_ns, sequence, *row)
        if self._states is not None:
            self._add(self._states, time_ns, sequence, *states)
        if not isnan(sample.reference_x_m) and self._reference64 is not None:
            values = sample.reference_x_m, sample.reference_y_m, sample.reference_heading_rad
            self._add_varied(topics.REFERENCE, time_ns, describe_pose(time_ns, *values), sequence)
            self._add(self._reference64, time_ns, sequence, *values)
        if self._shaped is not None:
            shaped = sample.shaped_speed_m_s, 0.0, 0.0, 0.0, 0.0, sample.shaped_turn_rate_rad_s
            self._add(self._shaped, time_ns, sequence, *shaped)
        self._has_samples = True
        if not self._has_world:
            self._has_world = not all(map(isnan, row[topics.WORLD_PLACES]))
        if self._goal is None:
            self._lacking |= {
                name
                for name, places in topics.GOAL_PLACES.items()
                if any(isnan(row[at]) for at in places)
            }

    def _follow_phase(self, sample: SampleRow) -> None:
        if sample.phase != self._phase:
            if self._phase is not None:
                self._add_pause()
            self._phase, self._is_paused = sample.phase, False
            self._add_varied(topics.PHASE, sample.time_ns, {"data": self._phases[sample.phase]})
        self._sample_ns, self._is_blocked = sample.time_ns, sample.blocks_ticks > 0
        if self._is_blocked and sample.ends_phase:
            self._add_pause()

    def _end_phase(self, time_ns: int, stop_reason: str) -> None:
        if self._is_blocked:
            self._add_pause()
        if stop_reason not in CUT_SHORT:
            self._add_varied(topics.PHASE, time_ns, {"data": DONE})

    def _add_pause(self) -> None:
        if not self._is_paused:
            self._add_varied(topics.PHASE, self._sample_ns, {"data": PAUSE})
        self._is_paused = True

    def _add(self, messages: _Messages, time_ns: int, sequence: int, *values: float) -> None:
        messages.entries += (time_ns, len(self._records))
        head = messages.length, messages.number, sequence, time_ns, time_ns, ENCAPSULATION
        self._records += messages.pack(_MESSAGE, *head, *values)

    def _add_varied(
        self,
        topic: topics.Topic,
        time_ns: int,
        values: Mapping[str, Any],
        number: int | None = None,
    ) -> None:
        """Add a message. Without a given number, messages are numbered from 0."""
        messages = self._messages[topic.name]
        kind = read_type(topic.schema, topics.SCHEMAS[topic.schema])
        stamp = messages.count if number is None else number, time_ns, time_ns
        record = encode_message(kind.fields, values, messages.number, stamp)
        messages.entries += (time_ns, len(self._records))
        self._records += record
        messages.count += 1

    def _collect(self) -> ChunkRows:
        index = {
            messages.number: np.array(messages.entries, dtype=np.uint64).reshape(-1, 2)
            for messages in self._messages.values()
            if messages.entries
        }
        for messages in self._messages.values():
            messages.entries = []
        records, self._records = self._records, bytearray()
        return ChunkRows(
            channels=[self._channels[number - 1] for number in index],
            records=records,
            index=index,
        )
