"""Where material that is not part of the project lies, for the tests that compare with it."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_shared_data = pytest.mark.skipif(not SHARED.is_dir(), reason="no ../shared/data beside the checkout")
