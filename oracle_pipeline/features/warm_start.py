"""What the first recording makes a process load, to be imported where processes are forked from.

A fork takes over what is loaded. Otherwise each fork loads it again for its own recording, which
takes as long as the features of a short one.
"""

import gc

import networkx  # noqa: F401 -- of graphs, imported where it is used
import pandas  # noqa: F401 -- of the tables, likewise
import scipy.ndimage  # noqa: F401 -- of maps, likewise
from numba.core.registry import cpu_target

from oracle_pipeline.bags.types import typestore

# The functions that numba knows, which it collects when it first loads compiled code.
cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
typestore()  # the definitions of ROS 2
gc.freeze()  # a fork does not search all of this for garbage
