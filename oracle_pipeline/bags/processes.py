"""How processes of ours start: others without the program, and with our own packages."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

# Imported first, it finds our packages in a folder with others of their names.
FINDS_OURS = "oracle_pipeline.programs"


def collect_rarely() -> None:
    """Let Python look for garbage less often than after every 700 new objects.

    Imports make hundreds of thousands that stay, among which it found nothing, again and again.
    """
    gc.set_threshold(50_000)


@contextmanager
def no_program() -> Iterator[None]:
    """Hide which program this is from a process that is started.

    It would import the program: a script would run again, and ``dagster`` takes a second.
    """
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = program
