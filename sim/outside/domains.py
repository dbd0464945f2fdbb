"""Numbers of DDS domains that processes on this machine share out among them."""

import contextlib
import fcntl
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

_POLL_S = 0.5


@contextlib.contextmanager
def a_free_domain(numbers: Sequence[int]) -> Iterator[int]:
    """Yield the number of a domain that no other process has now; wait until there is one."""
    while True:
        for number in numbers:
            with Path(tempfile.gettempdir(), f"dds-domain-{number}.lock").open("w") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                yield number
                return
        time.sleep(_POLL_S)
