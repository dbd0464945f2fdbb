"""What tests of the language share."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def quiet():
    """As expressions are run: NaN and infinities are values like others."""
    with np.errstate(all="ignore"):
        yield
