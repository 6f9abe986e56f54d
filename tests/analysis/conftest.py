"""Tiny checkpoints that all analyses are tried on."""

from pathlib import Path

import pytest
import tiny_checkpoints


@pytest.fixture(scope="session")
def lisa(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint for BabyAI's features."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("lisa"))


@pytest.fixture(scope="session")
def continuous_skills(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint without codes, for BabyAI's features."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("continuous_skills"), continuous_skills=True)


@pytest.fixture(scope="session")
def lang_dt(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a Lang-DT checkpoint for BabyAI's features."""
    return tiny_checkpoints.lang_dt(symbolic, tmp_path_factory.mktemp("lang_dt"))
