"""Imports of modules that stay until the process ends."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def lasting_imports() -> Iterator[None]:
    """Keep the garbage collector away from what is imported: now, later and at the exit.

    It would search all the modules again and again, which takes a short command longer than the
    search is worth.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()
