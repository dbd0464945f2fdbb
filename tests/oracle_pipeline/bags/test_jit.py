import importlib
import sys

import pytest

from oracle_pipeline.bags.jit import load_kept

LOOPS = """
from oracle_pipeline.bags.jit import jit

@jit
def half(x):
    return x / 2

@jit
def quarter(x):
    return half(half(x))
"""


@pytest.fixture
def loops(tmp_path, monkeypatch):
    """Return a function that imports compiled loops as a new process does."""
    (tmp_path / "loops.py").write_text(LOOPS)
    monkeypatch.syspath_prepend(tmp_path)

    def load():
        monkeypatch.delitem(sys.modules, "loops", raising=False)
        return importlib.import_module("loops")

    yield load
    del sys.modules["loops"]


def test_kept_code_is_loaded_before_the_first_call(loops):
    first = loops()
    assert first.quarter(3.0) == 0.75
    again = loops()
    assert not again.quarter.signatures
    load_kept()
    assert again.quarter.signatures == first.quarter.signatures
    assert not again.half.signatures  # a part of the code of the other
