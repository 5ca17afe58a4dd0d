"""How help looks: each paragraph is wrapped once, and no line is longer than the terminal."""

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, get_origin

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

_WIDEST: Final = 100
"""Longer lines are hard to read [characters]."""


class HelpFormatter:
    """Cyclopts' panels, of texts whose line ends are those of the source code.

    It knows nothing of a command that nobody has loaded yet: those are described by summaries.
    What draws panels is loaded where help is printed, not by every command.
    """

    def __init__(self, summaries: Mapping[str, str]) -> None:
        """Take what commands do, in one sentence each, by their names."""
        self._summaries = summaries

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Print a panel."""
        from cyclopts.help import DefaultFormatter

        console.width = min(console.width, _WIDEST)
        described = panel.copy(entries=[*map(self._describe, panel.entries)])
        DefaultFormatter()(console, options, described)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: Any) -> None:
        """Print how a command is called."""
        from cyclopts.help import DefaultFormatter

        DefaultFormatter().render_usage(console, options, usage)

    def _describe(self, entry: "HelpEntry") -> "HelpEntry":
        from cyclopts.help import InlineText

        text = " ".join(_find_text(entry.description).split())
        if not text and entry.positive_names:
            text = self._summaries.get(entry.positive_names[0], "")
        label = entry.positional_label
        if label and get_origin(entry.type) is list:
            label = f"{label}..."
        description = InlineText.from_format(text, "plaintext")
        return entry.copy(description=description, positional_label=label)

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
    return getattr(getattr(description, "primary_renderable", description), "plain", "")
