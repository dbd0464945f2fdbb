"""The report beside Dagster's pages, since a browser follows no ``file:`` link from a web page.

Pages are made from recordings, which anybody may have made. They are served without leave to run
scripts, so that whatever stands in them cannot use the UI in the reader's name.
"""

from pathlib import Path
from typing import Any

from starlette.responses import Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

REPORT_PATH = "/oracle/report"  # the address of the report, below that of the UI
_NO_SCRIPTS = "sandbox; default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'"


class _Pages(StaticFiles):
    """The files of a folder, as pages that do nothing."""

    async def check_config(self) -> None:
        """Take a folder that is not there yet: then there is no page."""

    def file_response(self, *arguments: Any, **settings: Any) -> Response:
        response = super().file_response(*arguments, **settings)
        response.headers["Content-Security-Policy"] = _NO_SCRIPTS
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


def report_route(folder: Path) -> Mount:
    """Return the route that serves a report's folder; there may be no report yet."""
    return Mount(REPORT_PATH, _Pages(directory=folder, html=True, check_dir=False))
