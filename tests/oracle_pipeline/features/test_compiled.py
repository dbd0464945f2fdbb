"""Laws of compiled plugins that need no compiler; tests/compiled builds and runs them."""

import numpy as np
import pytest

from oracle_pipeline.features import build_manager
from oracle_pipeline.features.adapters.compiled import load_compiled
from oracle_pipeline.features.engine.plugin import PluginError


def test_a_file_that_is_no_library_is_left_out_with_the_reason(tmp_path):
    (tmp_path / "nothing.so").write_bytes(b"not a library")
    manager = build_manager(tmp_path)
    assert "OSError" in manager.broken["nothing"]
    assert manager.plugins


def test_a_library_that_is_no_plugin_is_refused_with_an_error():
    library = next(path for path in _libraries() if path.suffix == ".so")
    with pytest.raises(PluginError, match="no function oracle_plugin_v1; it is no plugin, or one"):
        load_compiled(library)


def _libraries():
    from pathlib import Path

    return sorted(Path(np.__file__).parent.joinpath("random").iterdir())
