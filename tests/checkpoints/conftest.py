"""A small checkpoint, and copies of it that a test may change."""

from pathlib import Path

import pytest
import tiny_checkpoints
from checkpoint_copy import Copy


@pytest.fixture(scope="session")
def lisa(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint for BabyAI's features."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("lisa"))


@pytest.fixture
def copy(lisa: Path, tmp_path: Path) -> Copy:
    """Of the LISA checkpoint."""
    return Copy(lisa, tmp_path / "checkpoint")
