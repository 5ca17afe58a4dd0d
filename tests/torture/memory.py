"""Reads damaged files with little memory to spare, in a process of its own; Linux.

Run as `python -m tests.torture.memory SEED COUNT RECORDING...`: prints what needed more.
"""

import json
import re
import sys
import tempfile
from pathlib import Path
from random import Random

from tests.torture.outcomes import Harm, Overwrite, Readers, sample_harms
from tests.torture.recordings import list_records

SPARE = 2**26
"""Bytes that a damaged file may take beyond a sound one."""

CLAIMS = (2**27, 2**30, 2**31 - 1, 2**33, 2**40, 2**62)
CHUNK, HEAD = 6, 9


def list_lies(data: bytes) -> list[Harm]:
    """Return the file with each length of a record or chunk, and with counts, claiming far more."""
    lies: list[Harm] = []
    for opcode, place, length in list_records(data):
        places = [place + 1]
        if opcode == CHUNK:
            name = int.from_bytes(data[place + HEAD + 28 : place + HEAD + 32], "little")
            start = place + HEAD + 32 + name
            # The size unpacked, the size packed, and what frames of zstd and lz4 say of themselves.
            places += [place + HEAD + 16, start, start + 13, start + 14, start + 15]
        elif length >= 12:
            places += [place + HEAD, place + HEAD + 4]
        for claim in CLAIMS:
            claimed = claim.to_bytes(8, "little")
            lies += [Overwrite(at, claimed) for at in places]
    return lies


def limit_memory() -> None:
    """Allow this process what it has, and a little more."""
    # Not everywhere.
    import resource

    status = Path("/proc/self/status").read_text("ascii")
    peak = int(re.search(r"VmPeak:\s+(\d+) kB", status)[1]) * 1024  # type: ignore[index]
    resource.setrlimit(resource.RLIMIT_AS, (peak + SPARE, peak + SPARE))


def main(seed: int, count: int, paths: list[Path]) -> None:
    sounds = [path.read_bytes() for path in paths]
    with tempfile.TemporaryDirectory() as folder:
        all_readers = [Readers(sound, Path(folder)) for sound in sounds]
        for sound, readers in zip(sounds, all_readers, strict=True):
            for _ in readers.try_all(sound):
                pass
        limit_memory()
        tried = 0
        for path, sound, readers in zip(paths, sounds, all_readers, strict=True):
            lies = list_lies(sound)
            chosen = Random(seed).sample(lies, min(count, len(lies)))
            for harm in [*chosen, *sample_harms(sound, count, seed)]:
                tried += 1
                for name, _, text in readers.try_all(harm.apply(sound)):
                    if re.search(r"memory|alloc", text, re.IGNORECASE):
                        found = [path.name, name, repr(harm), text]
                        sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.write(json.dumps(tried) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
