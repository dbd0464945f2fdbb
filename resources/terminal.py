"""The terminal that this process was started from.

Inside a step Dagster sends standard error to a log file, and a progress bar there would be either
silent or noise; so the terminal is taken note of when this module is imported.
"""

import os
import sys
from typing import TextIO

_TERMINAL = os.fdopen(os.dup(sys.stderr.fileno()), "w") if sys.stderr.isatty() else None


def stderr() -> TextIO:
    """Return the terminal; what standard error is now, if there was none."""
    return _TERMINAL or sys.stderr
