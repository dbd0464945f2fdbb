"""When a source of messages is too busy for their times."""

import time
from contextlib import closing

from oracle_pipeline.live.domain import Domain


def test_a_program_that_was_stopped_outside_a_pause_is_late_until_it_has_what_came(domain):
    with closing(Domain(domain)) as source:
        until = time.monotonic() + 60.0
        while source.pause() and time.monotonic() < until:  # another program may be busy now
            pass
        time.sleep(1.2)  # as SIGSTOP does
        assert all(source.pause() for _ in range(10))  # half a second
