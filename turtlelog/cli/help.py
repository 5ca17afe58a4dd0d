"""How help looks: each paragraph is wrapped once, and no line is longer than the terminal."""

import textwrap
from collections.abc import Mapping, Set as Collection
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

    shows_all: bool = False
    """Whether to show every option and paragraph, as --help-all asks; otherwise the usual ones."""

    def __init__(self, summaries: Mapping[str, str], usual: Mapping[str, Collection[str]]) -> None:
        """Take what commands do, in one sentence each, and their usual options."""
        self._summaries, self._usual = summaries, usual
        self._command = ""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Print a panel."""
        from cyclopts.help import DefaultFormatter

        console.width = min(console.width, _WIDEST)
        entries = [*filter(self._is_shown, panel.entries)]
        described = panel.copy(entries=[*map(self._describe, entries)])
        if entries:
            DefaultFormatter()(console, options, described)

    def _is_shown(self, entry: "HelpEntry") -> bool:
        """Return whether help shows an option: a usual one, any where all are asked for."""
        usual = self._usual.get(self._command)
        if self.shows_all or usual is None or entry.positional_label or entry.required:
            return True
        return not usual.isdisjoint(entry.positive_names)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: Any) -> None:
        """Print how a command is called."""
        from cyclopts.help import DefaultFormatter

        words = (usage if isinstance(usage, str) else _find_text(usage)).split()
        # Behind `Usage: turtlelog`.
        self._command = next((word for word in words[2:3] if word in self._usual), "")
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

    def _choose(self, paragraphs: list[str]) -> list[str]:
        """Return the paragraphs to show: what a command does, and an example."""
        if self.shows_all or self._command not in self._usual:
            return paragraphs
        examples = [text for text in paragraphs if text.startswith("Example: ")]
        more = f"All options and examples: turtlelog {self._command} --help-all"
        return [*paragraphs[:1], *examples[:2], more]

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
            for paragraph in self._choose(_list_paragraphs(description))
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
