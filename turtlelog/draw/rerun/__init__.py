"""Rerun recordings, their layouts, and the viewer that shows them."""

import os

from turtlelog.libraries import load_library


def _import_rerun() -> None:
    """Import Rerun without what it logs of viewers that go away and of full disks.

    turtlelog says so in a line. Rerun reads its log filter once, here; one of the user's own stays.
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
