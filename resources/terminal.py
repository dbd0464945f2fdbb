"""The terminal that this process was started from, for progress bars.

Inside a step, Dagster redirects standard error to a log file. So the terminal is remembered when
this module is imported.
"""

import os
import sys
from typing import TextIO

_TERMINAL = os.fdopen(os.dup(sys.stderr.fileno()), "w") if sys.stderr.isatty() else None


def stderr() -> TextIO:
    """Return the terminal, or the present standard error if there is no terminal."""
    return _TERMINAL or sys.stderr
