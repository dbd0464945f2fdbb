"""Settings that every test runs under."""

from hypothesis import settings

# The same examples everywhere, and no deadline: a busy machine is not a wrong answer.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")
