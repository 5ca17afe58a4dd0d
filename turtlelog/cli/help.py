"""How help looks: each paragraph is wrapped once, and no line is longer than the terminal."""

import textwrap
from typing import TYPE_CHECKING, Any, Final, get_origin

from cyclopts.help import DefaultFormatter, InlineText

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

_WIDEST: Final = 100
"""Longer lines are hard to read [characters]."""


class HelpFormatter(DefaultFormatter):
    """Cyclopts' panels, of texts whose line ends are those of the source code."""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Print a panel."""
        console.width = min(console.width, _WIDEST)
        super().__call__(console, options, panel.copy(entries=[*map(_unwrap, panel.entries)]))

    def render_description(
        self,
        console: "Console",
        options: "ConsoleOptions",  # noqa: ARG002
        description: Any,
    ) -> None:
        """Print what a command does, then its examples."""
        width = min(console.width, _WIDEST)
        text = "\n\n".join(
            textwrap.fill(paragraph, width, break_long_words=False, break_on_hyphens=False)
            for paragraph in _list_paragraphs(description)
        )
        console.print(f"{text}\n", highlight=False, markup=False, soft_wrap=True)


def show_default(value: object) -> str | None:
    """Return how help shows a default; that an option is not given goes without saying."""
    return None if value is False or value is None else str(value)


def _list_paragraphs(description: Any) -> list[str]:
    text = _find_text(description)
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]


def _find_text(description: Any) -> str:
    held = description.primary_renderable if isinstance(description, InlineText) else description
    return getattr(held, "plain", "")


def _unwrap(entry: "HelpEntry") -> "HelpEntry":
    text = " ".join(_find_text(entry.description).split())
    label = entry.positional_label
    if label and get_origin(entry.type) is list:
        label = f"{label}..."
    description = InlineText.from_format(text, "plaintext")
    return entry.copy(description=description, positional_label=label)
