"""What every test shares: the reference in `tests/analytic`, and repeatable hypothesis runs."""

from __future__ import annotations

import sys
from pathlib import Path

from hypothesis import settings

TESTS = str(Path(__file__).resolve().parent)
if TESTS not in sys.path:  # so that `from analytic import ryrz` works from any test, in any import mode
    sys.path.insert(0, TESTS)

settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci")  # `pytest --hypothesis-profile=default` overrides it
