"""An MkDocs hook: refuses pages that load anything from another host."""

import re
from typing import Any

from mkdocs.exceptions import PluginError

_ELSEWHERE = re.compile(
    r"<(?:script|img|iframe)[^>]+src=\"https?:[^>]+>|<link[^>]+href=\"https?:[^>]+>"
)


def on_post_page(output: str, **context: Any) -> None:
    """Raise if the page would need a network to be shown."""
    if found := _ELSEWHERE.search(output):
        raise PluginError(f"{context['page'].file.src_path} loads from elsewhere: {found[0]}")
