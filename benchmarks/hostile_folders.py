"""Hostile folders of bags: descriptions that lie, links, pipes, and very many files."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from benchmarks.hostile_mcap import make_poses
from benchmarks.put_files import Make
from tests.torture.bombs import chunk, describe, message, whole

_YAML: Final = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"


def _folder(make: Callable[[Path], Any]) -> Make:
    def fill(folder: Path) -> Path:
        place = folder / "bag"
        place.mkdir()
        make(place)
        return place

    return fill


def _describe(text: str) -> Make:
    def put(place: Path) -> Path:
        (place / "metadata.yaml").write_text(text, "utf-8")
        (place / "bag_0.mcap").write_bytes(
            whole(chunk([describe("/turtle1/pose"), make_poses(100)]))
        )
        return place

    return _folder(put)


def _name_files(*names: str) -> Make:
    lines = "".join(f"    - {name}\n" for name in names)
    return _describe(f"{_YAML}  relative_file_paths:\n{lines}")


def _fill_with_files(place: Path) -> None:
    for number in range(100_000):
        (place / f"bag_{number}.mcap").touch()


def _nest_folders(place: Path) -> None:
    for number in range(400):
        place = place / f"{number % 10}"
    place.mkdir(parents=True)
    (place / "bag_0.mcap").write_bytes(b"")


def _put_pipe(place: Path) -> None:
    os.mkfifo(place / "bag_0.mcap")
    (place / "metadata.yaml").write_text(f"{_YAML}  relative_file_paths: [bag_0.mcap]\n", "utf-8")


def _put_device(place: Path) -> None:
    (place / "bag_0.mcap").symlink_to("/dev/zero")
    (place / "metadata.yaml").symlink_to("/dev/zero")


def _put_loop(place: Path) -> None:
    (place / "bag_0.mcap").symlink_to("bag_0.mcap")
    (place / "bag_1.mcap").symlink_to(".")
    (place / "metadata.yaml").symlink_to("metadata.yaml")


def _share_rows(place: Path) -> None:
    """Many links to one file that takes as much as a file may."""
    content = whole(chunk([describe("/turtle1/pose"), message(1) * 1_200_000]))
    (place / "bag_0.mcap").write_bytes(content)
    for number in range(1, 300):
        (place / f"bag_{number}.mcap").symlink_to("bag_0.mcap")


FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        "yaml: a line of blanks and quotes": _describe(_YAML + "  x: " + "' " * 4_900_000),
        "yaml: blanks": _describe(_YAML + " " * 9_800_000),
        "yaml: anchors": _describe(
            _YAML
            + "  a0: &a0 [x, x]\n"
            + "".join(f"  a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(64))
        ),
        "yaml: tags": _describe(
            f"{_YAML}  x: !!python/object/apply:os.abort []\n  y: !!binary {'A' * 4_000_000}\n"
        ),
        "yaml: 2 M documents": _describe(_YAML + "---\n" * 2_000_000),
        "yaml: merges": _describe(
            "a0: &a0 {x: 1}\n"
            + "".join(f"a{n + 1}: &a{n + 1} {{<<: [*a{n}, *a{n}]}}\n" for n in range(60))
            + _YAML
        ),
        "yaml: numbers of 4 M digits": _describe(
            f"{_YAML}  x: {'9' * 4_000_000}\n  y: 1:{'59:' * 500_000}59\n"
        ),
        "yaml: 300,000 keys": _describe(
            _YAML + "".join(f"  k{n}: [{n}]\n" for n in range(300_000))
        ),
        "yaml: lists in lists": _describe(_YAML + "  x: " + "[" * 9_000_000),
        "yaml: 100,000 files": _name_files(*(f"bag_{n}.mcap" for n in range(100_000))),
        "yaml: a file 100,000 times": _name_files(*["bag_0.mcap"] * 100_000),
        "yaml: files elsewhere": _name_files("../../../etc/passwd", "/etc/passwd"),
        "yaml: itself": _name_files("metadata.yaml"),
        "folder: pipe": _folder(_put_pipe),
        "folder: /dev/zero": _folder(_put_device),
        "folder: links to themselves": _folder(_put_loop),
        "folder: 300 links to one file": _folder(_share_rows),
        "folder: 400 folders deep": _folder(_nest_folders),
        "folder: 100,000 empty files": _folder(_fill_with_files),
    }
)
"""By name."""
