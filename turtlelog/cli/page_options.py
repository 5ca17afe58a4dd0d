"""Where figures of `turtlelog plot` will stand, and what of the runs they show there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

from turtlelog import draw
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.draw import Page


TIMELESS: Final = frozenset(
    {
        *("plant", "step-responses", "root-locus", "bode", "nyquist", "step"),
        *("gains", "luck", "strips"),
    }
)
"""Figures that times cannot cut: no axis shows runs over time, nor a path driven in it."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PageOptions:
    """Where figures will stand, and what they show of the runs.

    Attributes:
        kind: column is one of two columns of a paper, page its whole width, slide 16:9 with large
            lettering; figures with panels side by side always take the page. Default: column, and
            page for the table of a sweep.
        text_width: Width of the paper's text [mm], 120 to 1000. Default: 181. Not for a slide.
        dpi: Resolution of PNGs [dots per inch], 50 to 600. Default: 300; for a slide 144, which is
            1920 by 1080 pixels.
        from_s: Begin time axes here, from the first sample [s].
        to_s: End time axes here [s].
        marks: Mark rise, settling time with its band, peak and overshoot, dead time and pause on
            the curves that loops control, and cut single panels to the phase.
    """

    kind: Annotated[Literal["column", "page", "slide"] | None, Parameter(name="--for")] = None
    text_width: Annotated[float | None, Parameter(metavar="WIDTH")] = None
    dpi: int | None = None
    from_s: Annotated[float | None, Parameter(name="--from", metavar="SECONDS")] = None
    to_s: Annotated[float | None, Parameter(name="--to", metavar="SECONDS")] = None
    marks: Annotated[bool, Parameter(negative=())] = False

    def build_page(
        self,
        formats: Sequence[str],
        names: Sequence[str] | None,
        *,
        usual: Literal["column", "page"] = "column",
    ) -> "Page":
        """Return the page for figures in some formats.

        Args:
            formats: In which they are written.
            names: Names of the figures; None for the usual ones.
            usual: Where they will stand if that is not asked for.

        Raises:
            UsageError: If an option has nothing to act on: no format has a resolution, a slide no
                text, or no figure a time axis.
            ShowError: If a value is out of range.
        """
        if self.text_width is not None and self.kind == "slide":
            raise UsageError("--text-width: needs --for column or page, not slide")
        for option, bound_s in (("--from", self.from_s), ("--to", self.to_s)):
            if bound_s is not None and not math.isfinite(bound_s):
                raise UsageError(f"{option} {bound_s:g}: must be a finite time [s]")
            if bound_s is not None and names and TIMELESS.issuperset(names):
                found = ", ".join(names)
                raise UsageError(f"{option}: needs a figure over time, not {found}")
        if self.dpi is not None and "png" not in formats:
            raise UsageError(f"--dpi: is for png files, not {', '.join(formats)}")
        return draw.Page(
            kind=self.kind or usual,
            **({} if self.text_width is None else {"text_width_mm": self.text_width}),
            dpi=self.dpi,
            from_s=self.from_s,
            to_s=self.to_s,
            has_marks=self.marks,
        )
