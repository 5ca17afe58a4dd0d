"""Rerun recordings, their layouts, and the viewer that shows them."""

import os


def _import_rerun() -> None:
    """Import Rerun without what it logs about viewers that go away: turtlelog says so in a line.

    It reads its log filter once, here; one of the user's own stays.
    """
    name = "RUST_LOG"
    if name in os.environ:
        return
    os.environ[name] = "warn,re_grpc_client=off,re_sdk::recording_stream=off"
    try:
        import rerun  # noqa: F401
    finally:
        del os.environ[name]


_import_rerun()
