"""What a page of HTML may run and load: a Content-Security-Policy that allows the page alone."""

from base64 import b64encode
from collections.abc import Iterable
from hashlib import sha256
from typing import Final

_SOURCES: Final = {
    "default_src": "'none'",
    "style_src": "'unsafe-inline'",
    "img_src": "data: blob:",
    "base_uri": "'none'",
    "form_action": "'none'",
}
"""Bokeh and Rerun write styles while they draw. What a style could fetch is refused by the rest."""


def write_policy(scripts: Iterable[str], **more: str) -> str:
    """Return a policy: the scripts that stand in the page, by their hashes, and nothing remote.

    Args:
        scripts: The text of each; data blocks, as of JSON, are no scripts.
        more: Further sources by directive, with `_` for `-`, as `connect_src="'self'"`.
    """
    hashes = (b64encode(sha256(code.encode()).digest()).decode() for code in scripts)
    ours = {"script_src": " ".join(f"'sha256-{found}'" for found in hashes), **_SOURCES}
    sources = {
        name: f"{ours.get(name, '')} {more.get(name, '')}".strip() for name in {**ours, **more}
    }
    return "; ".join(
        f"{name.replace('_', '-')} {source}" for name, source in sources.items() if source
    )


def write_policy_tag(*scripts: str) -> str:
    """Return the tag for the head of a page that is a file, before all else that loads."""
    policy = write_policy(scripts)
    return f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
