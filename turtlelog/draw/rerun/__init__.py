"""Rerun recordings, their layouts, and the viewer for them."""

import os

from turtlelog.libraries import load_library


def _import_rerun() -> None:
    """Import Rerun without its log messages about closed viewers and full disks.

    turtlelog reports these errors in one line. Rerun reads its log filter once, here; a filter set
    by the user is kept.
    """
    name = "RUST_LOG"
    if name in os.environ:
        load_library("rerun")
        return
    ours = ("re_grpc_client", "re_sdk::recording_stream", "re_log_encoding::rrd")
    os.environ[name] = ",".join(["warn", *(f"{module}=off" for module in ours)])
    try:
        load_library("rerun")
    finally:
        del os.environ[name]


_import_rerun()
