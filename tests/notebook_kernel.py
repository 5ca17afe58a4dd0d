"""A notebook without its page: a kernel that runs cells, and a client that answers as a page."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty
from typing import Any, Final

PATIENCE_S: Final = 60.0


@dataclass(slots=True)
class Cell:
    """What a cell sent to its page.

    Attributes:
        printed: Text of stdout and stderr.
        error: Name and value of the exception that ended it; empty without one.
        shown: Data of each output by media type.
        sent: Custom messages of widgets, each with its time [s] and its buffers.
    """

    printed: str = ""
    error: str = ""
    shown: list[dict[str, Any]] = field(default_factory=list)
    sent: list[tuple[float, dict[str, Any], list[bytes]]] = field(default_factory=list)


class Notebook:
    """A kernel with the client of its page."""

    def __init__(self, client: Any, *, is_open: bool) -> None:
        """Take the client; `is_open`: whether the page tells each widget that it is ready."""
        self._client, self._is_open = client, is_open
        self._subshell = self._open_subshell()
        self._widgets: list[str] = []

    def _open_subshell(self) -> str:
        """Open the second thread in which JupyterLab has messages of widgets handled."""
        client = self._client
        client.control_channel.send(client.session.msg("create_subshell_request"))
        reply = client.get_control_msg(timeout=PATIENCE_S)
        subshell: str = reply["content"]["subshell_id"]
        return subshell

    def run_cell(self, code: str) -> Cell:
        """Run a cell to its end."""
        cell, client = Cell(), self._client
        asked = client.execute(code)
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            try:
                message = client.get_iopub_msg(timeout=1.0)
            except Empty:
                continue
            content = message["content"]
            if message["msg_type"] == "status" and content["execution_state"] == "idle":
                if message["parent_header"].get("msg_id") == asked:
                    return cell
            else:
                self._receive(cell, message["msg_type"], message)
        raise TimeoutError(f"a cell took more than {PATIENCE_S:g} s: {code}")

    def open_pages(self) -> Cell:
        """Open the pages of the widgets of earlier cells, and return what they get."""
        while self._widgets:
            self._answer(self._widgets.pop())
        return self.run_cell("")

    def _receive(self, cell: Cell, kind: str, message: dict[str, Any]) -> None:
        content = message["content"]
        if kind == "stream":
            cell.printed += content["text"]
        elif kind == "error":
            cell.error = f"{content['ename']}: {content['evalue']}"
        elif kind in {"display_data", "execute_result"}:
            cell.shown.append(content["data"])
            if self._is_open and "rerun_notebook.Viewer" in content["data"]["text/plain"]:
                self._answer(self._widgets.pop())
        elif kind == "comm_open" and "_esm" in content["data"]["state"]:
            self._widgets.append(content["comm_id"])
        elif kind == "comm_msg" and content["data"].get("method") == "custom":
            buffers = [bytes(one) for one in message["buffers"]]
            cell.sent.append((time.monotonic(), content["data"]["content"], buffers))

    def _answer(self, comm: str) -> None:
        data = {"method": "custom", "content": "ready"}
        content = {"comm_id": comm, "data": data}
        message = self._client.session.msg("comm_msg", content)
        message["header"]["subshell_id"] = self._subshell
        self._client.shell_channel.send(message)


@contextmanager
def start_notebook(*, is_open: bool = True, folder: Path | None = None) -> Iterator[Notebook]:
    """Start a kernel of this Python, in a folder, and end it with the block."""
    from jupyter_client.manager import KernelManager

    manager = KernelManager()
    launcher = ["-m", "ipykernel_launcher", "-f", "{connection_file}"]
    assert manager.kernel_spec is not None
    manager.kernel_spec.argv = [sys.executable, *launcher]
    manager.start_kernel(cwd=None if folder is None else str(folder))
    client = manager.client()
    client.start_channels()
    try:
        client.wait_for_ready(timeout=PATIENCE_S)
        yield Notebook(client, is_open=is_open)
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
