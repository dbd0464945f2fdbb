"""Loads the compiled loops of a run and its features, so that a fork need not load them again."""

import gc

from tools.scripts.compile_loops import measure, simulate

simulate()
measure()
gc.freeze()  # no fork looks for garbage in what all share
