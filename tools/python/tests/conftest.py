"""Records that the project keeps in its repository, and the program where it was built."""

import os
import pathlib

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[3]
OUTPUTS = ROOT / "tests/golden/outputs"


@pytest.fixture
def outputs():
    """The records of one clip."""
    return OUTPUTS


@pytest.fixture
def program(monkeypatch):
    """The program `rogs`; its tests are skipped, visibly, where it was not built."""
    built = [os.environ.get("ROGS_PROGRAM"), ROOT / "target/debug/rogs", ROOT / "target/release/rogs"]
    found = next((path for path in built if path and os.path.isfile(path)), None)
    if not found:
        pytest.skip("needs the program: cargo build -p rogs, or ROGS_PROGRAM")
    monkeypatch.setenv("ROGS_PROGRAM", os.fspath(found))
    return os.fspath(found)
