"""Two threads that request the same lock at once."""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager


def order_of_two(lock: Callable[[], AbstractContextManager[object]]) -> list[str]:
    """Return the order in which two threads finish, of which the first holds the lock already."""
    order: list[str] = []

    def wait_and_work() -> None:
        with lock():
            order.append("second")

    with lock():
        second = threading.Thread(target=wait_and_work)
        second.start()
        time.sleep(0.1)
        order.append("first")
    second.join()
    return order
