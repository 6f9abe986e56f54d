"""What LeRobot's `--dataset.eval_split` leaves to train on, as docs/faq.md tells it."""

from pathlib import Path

from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import make_train_eval_datasets

from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


def test_an_instruction_that_occurs_once_is_held_out_whole(symbolic: Path) -> None:
    """Of the six episodes two have the same instruction; however few are to be held out, one remains."""
    data = DatasetConfig(repo_id="local/tiny", root=str(symbolic), eval_split=0.01)
    config = TrainPipelineConfig(dataset=data, policy=LisaConfig(device="cpu", language_encoder="words"))
    train, held_out = make_train_eval_datasets(config)
    assert held_out is not None
    assert train.episodes == [0]
    assert sorted(held_out.episodes) == [1, 2, 3, 4, 5]
