"""A dataset's way to the Hub and back, card and all, as docs/datasets.md shows it, over real HTTP."""

import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest
from local_hub import LocalHub

from dataset_converters.card import DatasetCard, write_card

pytestmark = pytest.mark.slow
REPO = "me/tiny"
PAGE = Path(__file__).parents[2] / "docs" / "datasets.md"
LOAD = """
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("me/tiny")
print(dataset.num_episodes, dataset.meta.info.robot_type, dataset[0]["task"])
"""


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalHub]:
    with LocalHub(tmp_path_factory.mktemp("hub")) as serving:
        yield serving


def test_uploaded_with_its_card_and_loaded_by_name(hub: LocalHub, symbolic: Path, tmp_path: Path) -> None:
    card = DatasetCard("Made for a test.", {"Seeds": "1 to 6"}, "unknown", "url", "paper", "citation")
    write_card(symbolic, REPO, card)
    (commands,) = re.findall(r"```bash\n(hf upload .*?)```", PAGE.read_text(), re.DOTALL)
    commands = commands.replace("me/lorel_states", REPO).replace("data/lorel_states", str(symbolic))
    env = {key: value for key, value in os.environ.items() if not key.startswith("HF_")}
    env |= {"HF_ENDPOINT": hub.url, "HF_TOKEN": "hf_dummy", "HF_HOME": str(tmp_path), "HF_HUB_DISABLE_XET": "1"}
    env |= {
        "HF_HUB_DISABLE_UPDATE_CHECK": "1",
        "NO_PROXY": "127.0.0.1",
        "PATH": f"{sysconfig.get_path('scripts')}:{os.environ['PATH']}",
    }
    for command in (["bash", "-ec", commands], [sys.executable, "-c", LOAD]):
        done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert done.stdout == "6 None go to the red ball\n"
    files = hub.files(REPO)
    assert {path.relative_to(symbolic).as_posix() for path in symbolic.rglob("*") if path.is_file()} <= files.keys()
    assert "**Seeds:** 1 to 6" in files["README.md"].read_text()
    assert hub.tags == {REPO: ["v3.0"]}
