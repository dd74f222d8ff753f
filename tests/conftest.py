"""What all tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real recordings; tests that need it are skipped, with the reason, where it is missing."""
    root = Path(os.environ.get("ROADBLOCK_DATA", Path(__file__).parents[1] / "../shared/data")).resolve()
    if not root.is_dir():
        pytest.skip(f"no real recordings at {root} (set ROADBLOCK_DATA)")
    return root
