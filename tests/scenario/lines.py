"""Lines of errors, matched as a whole."""

import re


def match_whole(text: str) -> str:
    return rf"\A{re.escape(text)}\Z"
