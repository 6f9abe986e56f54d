"""Tiny checkpoints that all analyses are tried on."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import tiny_checkpoints
import tiny_datasets

from lerobot_lisa.analysis import drawing


@pytest.fixture(scope="session", autouse=True)
def _outlines_in_pdfs() -> Iterator[None]:
    """Embedding parts of fonts is a third of what a report takes; reports of README's first steps have them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(drawing._SETTINGS, "pdf.fonttype", 3)
        yield


@pytest.fixture(scope="session")
def lisa(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint for BabyAI's features."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("lisa"))


@pytest.fixture(scope="session")
def continuous_skills(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint without codes, for BabyAI's features."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("continuous_skills"), quantizer="continuous")


@pytest.fixture(scope="session")
def lang_dt(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a Lang-DT checkpoint for BabyAI's features."""
    return tiny_checkpoints.lang_dt(symbolic, tmp_path_factory.mktemp("lang_dt"))


@pytest.fixture(scope="session")
def babyai_rnn(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a checkpoint of BabyAI's own baseline."""
    return tiny_checkpoints.babyai_rnn(symbolic, tmp_path_factory.mktemp("babyai_rnn"))


@pytest.fixture(scope="session")
def lang_bc(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a checkpoint of behaviour cloning for BabyAI's features."""
    return tiny_checkpoints.lang_bc(symbolic, tmp_path_factory.mktemp("lang_bc"))


@pytest.fixture(scope="session")
def tabletop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint for LOReL's states."""
    features = {
        "observation.state": {"dtype": "float32", "shape": (15,), "names": None},
        "action": {"dtype": "float32", "shape": (5,), "names": None},
    }
    folder = tmp_path_factory.mktemp("tabletop")
    return tiny_checkpoints.lisa(tiny_datasets.write(folder / "data", features), folder / "lisa")
