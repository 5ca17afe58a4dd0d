"""The files of a bag."""

from pathlib import Path
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.border import name_file
from turtlelog.log.ros2.bag_metadata import BagMetadata, parse_bag_metadata

METADATA_FILE: Final = "metadata.yaml"


def list_bag_files(path: str | Path) -> tuple[Path, ...]:
    """Return the MCAP files of a bag in its own order: those that a folder names, or a lone file.

    Raises:
        LogError: Where a folder is no bag, lacks a file, or holds another kind of them.
    """
    path = Path(path)
    if not path.is_dir():
        return (path,)
    metadata = read_bag_metadata(path)
    with name_file(path / METADATA_FILE, expected="the description of a bag"):
        _require_plain_mcap(metadata)
        # Early versions put the folder's name in front.
        files = tuple(path / Path(name.replace("\\", "/")).name for name in metadata.files)
        for file in files:
            if not file.is_file():
                raise LogError(f"relative_file_paths: expected the file {file.name}, found none")
    return files


def read_bag_metadata(path: str | Path) -> BagMetadata:
    """Return what a bag folder says of itself.

    Raises:
        LogError: Where it is no bag.
    """
    place = Path(path) / METADATA_FILE
    if not place.is_file():
        raise LogError(f"{path}: expected a bag, found a folder without {METADATA_FILE}")
    with name_file(place, expected="the description of a bag"):
        return parse_bag_metadata(place.read_text("utf-8"))


def _require_plain_mcap(metadata: BagMetadata) -> None:
    advice = "ros2 bag convert makes MCAP of it"
    if metadata.storage != "mcap":
        raise LogError(
            f"storage_identifier: expected mcap, found {metadata.storage or 'none'}: {advice}"
        )
    if metadata.compression:
        raise LogError(f"compression_mode: expected none, found {metadata.compression}: {advice}")
