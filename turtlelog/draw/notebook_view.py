"""Display of a run in a notebook."""

from importlib.util import find_spec
from numbers import Integral
from typing import TYPE_CHECKING

from turtlelog.errors import ShowError
from turtlelog.run import Run, require_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rerun.notebook import Viewer


def show_run(run: Run, *, width: int = 960, height: int = 640) -> "Viewer | Figure":
    """Return a run as a widget of Rerun's viewer, or without the extra `notebook` as a figure.

    The figure is `panel`. A notebook shows the widget or figure as the value of a cell.

    Args:
        run: Run to show.
        width: Width of the widget [pixels].
        height: Height of the widget [pixels].

    Raises:
        ShowError: If width or height is below 1, or the environment disables Rerun.
    """
    require_run(run)
    for name, value in (("width", width), ("height", height)):
        if not isinstance(value, Integral) or value < 1:
            raise ShowError(f"{name}: must be at least 1 pixel, not {value!r:.60}")
    if any(find_spec(module) is None for module in ("rerun", "rerun_notebook")):
        from turtlelog.draw.figures import draw_figure  # not needed for the widget

        return draw_figure("panel", run)
    from turtlelog.draw.rerun.live_viewer import build_run_widget

    return build_run_widget(run, (width, height))
