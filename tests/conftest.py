"""Settings for the whole suite, and small LeRobotDatasets made on the spot."""

import os
import tempfile
from functools import cache
from pathlib import Path

# Both are read when LeRobot is imported: nothing is fetched, and nothing is left in the user's cache.
_home = tempfile.TemporaryDirectory(prefix="lerobot_home_", ignore_cleanup_errors=True)
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["HF_LEROBOT_HOME"] = _home.name

import hypothesis  # noqa: E402
import pytest  # noqa: E402
import tiny_datasets  # noqa: E402
import torch  # noqa: E402
from draccus.wrappers import docstring  # noqa: E402

# For every command LeRobot's parser looks in all source files for what stands beside options: half a second each time.
docstring.get_attribute_docstring = cache(docstring.get_attribute_docstring)
torch.set_num_threads(1)
hypothesis.settings.register_profile("exact", derandomize=True, deadline=None, max_examples=20)
hypothesis.settings.load_profile("exact")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with whole commands first: begun last, they keep one process busy while the others have nothing left."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def symbolic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of a dataset with BabyAI's features; `tiny_datasets.LENGTHS` are its episodes."""
    return tiny_datasets.symbolic(tmp_path_factory.mktemp("symbolic") / "data")


@pytest.fixture(scope="session")
def continuous(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of a dataset with real-valued states and actions."""
    return tiny_datasets.continuous(tmp_path_factory.mktemp("continuous") / "data")


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of a dataset with small images and a state."""
    return tiny_datasets.pictures(tmp_path_factory.mktemp("pictures") / "data")


@pytest.fixture
def lerobot_home() -> Path:
    """Where LeRobot keeps its caches during the tests."""
    return Path(_home.name)
