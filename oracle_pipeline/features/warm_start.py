"""What the first recording makes a process load, to be imported where processes are forked from.

A fork takes over what is loaded. Otherwise each fork loads it again for its own recording, which
takes as long as the features of a short one.
"""

import gc
import sys
from typing import Any

import jsonschema  # noqa: F401 -- of manifests, imported where it is used
import networkx  # noqa: F401 -- of graphs, likewise
import pandas  # noqa: F401 -- of the tables, likewise
import scipy.ndimage  # noqa: F401 -- of maps, likewise
from numba.core.registry import CPUDispatcher

from oracle_pipeline.bags.types import typestore


def load(function: Any) -> None:
    """Load the machine code of a function, for each type of its arguments that is on disk."""
    machine = function.targetctx.codegen().magic_tuple()
    for signature, made_for, _ in function._cache._cache_file._load_index():
        if made_for == machine:
            function.compile(signature)


for module in [each for name, each in sys.modules.items() if name.startswith("oracle_pipeline.")]:
    for function in vars(module).values():
        if isinstance(function, CPUDispatcher):
            load(function)
typestore()  # the definitions of ROS 2
gc.freeze()  # a fork does not search all of this for garbage
