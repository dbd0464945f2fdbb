"""The terminal that this process was started from, for progress bars.

Inside a step, Dagster redirects standard error to a log file. So this module keeps a reference to
the terminal from when it was imported.
"""

import os
import sys
from typing import TextIO

_TERMINAL = os.fdopen(os.dup(sys.stderr.fileno()), "w") if sys.stderr.isatty() else None


def stderr() -> TextIO:
    """Return the terminal, or the current standard error without a terminal."""
    return _TERMINAL or sys.stderr
