"""A meshcat server that the tests of a file share."""

from __future__ import annotations

import pytest

from pinposture.errors import ViewerError
from pinposture.viz.meshcat import Connection


@pytest.fixture(scope="module")
def running():
    """A server that runs already, shared by the tests of this file."""
    try:
        own = Connection()
    except ViewerError as error:
        pytest.skip(f"no meshcat server can run here: {error}")
    yield own
    own.close()
