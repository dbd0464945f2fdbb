"""What a command imports is not searched for garbage; what it makes afterwards is."""

import gc
import weakref

from oracle_pipeline.lasting_imports import lasting_imports


class _Loop:
    def __init__(self) -> None:
        self.itself = self


def test_only_what_is_made_after_the_imports_is_collected():
    try:
        with lasting_imports():
            imported = weakref.ref(_Loop())
        made = weakref.ref(_Loop())
        gc.collect()
        assert gc.isenabled()
        assert imported() is not None
        assert made() is None
    finally:
        gc.unfreeze()
    gc.collect()
    assert imported() is None
