"""An MkDocs hook that refuses pages which load anything from another host."""

import re
from typing import Any

from mkdocs.exceptions import PluginError

_ELSEWHERE = re.compile(
    r"<(?:script|img|iframe)[^>]+src=\"https?:[^>]+>|<link[^>]+href=\"https?:[^>]+>"
)


def on_post_page(output: str, **context: Any) -> None:
    """Raise an error if showing the page needs a network."""
    if found := _ELSEWHERE.search(output):
        raise PluginError(f"{context['page'].file.src_path} loads from elsewhere: {found[0]}")
