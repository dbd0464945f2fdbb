"""Serves the report beside Dagster's pages, since browsers refuse ``file:`` links from web pages.

Pages contain text from recordings of unknown origin. They must not run scripts, so that they cannot
use the UI on the reader's behalf.
"""

from pathlib import Path
from typing import Any

from starlette.responses import Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

REPORT_PATH = "/oracle/report"  # the address of the report, below that of the UI
_NO_SCRIPTS = "sandbox; default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'"


class _Pages(StaticFiles):
    """The files of a folder, served as pages that cannot run scripts."""

    async def check_config(self) -> None:
        """Accept a folder that does not exist yet."""

    def file_response(self, *arguments: Any, **settings: Any) -> Response:
        response = super().file_response(*arguments, **settings)
        response.headers["Content-Security-Policy"] = _NO_SCRIPTS
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


def report_route(folder: Path) -> Mount:
    """Return the route that serves a report's folder; there may be no report yet."""
    return Mount(REPORT_PATH, _Pages(directory=folder, html=True, check_dir=False))
