"""An attribution in sentences."""

from typing import Final

from turtlelog.explain.attribute import Attribution, Share

_NOTABLE: Final = 0.1
"""From this share of the figure on, acting together and helping are worth a clause."""


_NEGLIGIBLE: Final = 0.01


def write_sentences(found: Attribution) -> tuple[str, ...]:
    """Return what matters most, what is left without it, and what helps."""
    sentences = [_write_main(found), _write_remainder(found)]
    sentences += [_write_help(found, other) for other in found.others if _helps(found, other)]
    return tuple(filter(None, sentences))


def _write_main(found: Attribution) -> str:
    names = _join([share.mechanism for share in found.shares])
    without = _format(found, found.without_all)
    if not any(share.share for share in found.shares):
        return f"{found.metric} is {without}, with or without {names}."
    ordered = sorted(found.shares, key=lambda share: -abs(share.share or 0.0))
    parts = _join([_write_part(found, share) for share in ordered])
    together = _write_interaction(found)
    return (
        f"{found.metric} is {_format(found, found.as_built)}: {parts}{together};"
        f" without {names} it would be {without}."
    )


def _write_part(found: Attribution, share: Share) -> str:
    largest = max(abs(other.share or 0.0) for other in found.shares)
    if not share.share or abs(share.share) < _NEGLIGIBLE * largest:
        return f"{share.mechanism} changes {'next to ' if share.share else ''}nothing"
    size = _format(found, abs(share.share))
    if share.share > 0.0:
        return f"{share.mechanism} adds {size}"
    return f"{share.mechanism} helps and takes {size} away"


def _write_interaction(found: Attribution) -> str:
    largest = max(abs(share.share or 0.0) for share in found.shares)
    if len(found.shares) < 2 or abs(found.interaction) < _NOTABLE * largest:
        return ""
    size = _format(found, abs(found.interaction))
    verb = f"adds {size}" if found.interaction > 0.0 else f"takes {size} away"
    return f" (their acting together, which is in these shares, {verb})"


def _write_remainder(found: Attribution) -> str:
    if found.bound is None:
        return ""
    bound = _format(found, found.bound)
    if found.without_all <= 1.01 * found.bound:
        return f"What remains without them the heading tolerance explains: up to {bound}."
    return f"The heading tolerance explains {bound} of what remains without them."


def _helps(found: Attribution, other: Share) -> bool:
    if other.alone is None:
        return False
    return other.alone - found.as_built > _NOTABLE * abs(found.as_built)


def _write_help(found: Attribution, other: Share) -> str:
    return (
        f"{other.mechanism.capitalize()} helps: without it alone, all else as built,"
        f" it would be {_format(found, other.alone or 0.0)}."
    )


def _format(found: Attribution, value: float) -> str:
    return f"{value:.4g} {found.unit}".removesuffix(" 1")


def _join(words: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
