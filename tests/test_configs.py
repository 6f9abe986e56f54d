"""Every published configuration is what `lerobot-train --config_path` reads, and says what the paper says."""

from pathlib import Path

import pytest
from lerobot_options import read_training

from lerobot_lisa.envs.babyai.levels import LEVELS
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig

CONFIGS = Path(__file__).parents[1] / "configs"
BABYAI = sorted(CONFIGS.glob("babyai/*/*.yaml"))
RECIPES = [
    path for path in sorted(CONFIGS.glob("**/*.yaml")) if "rows" not in path.parts
]  # tests/reproduce reads those


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: str(path.relative_to(CONFIGS)))
def test_lerobot_train_reads_it(path: Path) -> None:
    config = read_training(path)

    assert isinstance(config.policy, EpisodePolicyConfig)
    assert config.policy.type == path.stem
    assert config.num_workers == 0
    assert not config.policy.push_to_hub  # nobody who copies the command should publish by accident


@pytest.mark.parametrize("path", BABYAI, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_names_agree(path: Path) -> None:
    config, (level, size) = read_training(path), path.parent.name.split("_")

    assert config.env is not None
    assert config.env.task in LEVELS
    assert config.env.task.lower() == level
    assert config.dataset.repo_id == f"local/babyai_{level}_{size}"
    assert f"{config.env.task} {size}" in path.read_text().splitlines()[0]


BOTH = sorted(
    {path.parent for path in BABYAI if path.stem == "lisa"} & {path.parent for path in BABYAI if path.stem == "lang_dt"}
)


@pytest.mark.parametrize("folder", BOTH, ids=lambda folder: folder.name)
def test_lisa_and_lang_dt_differ_only_in_the_policy(folder: Path) -> None:
    """The comparison is of methods: same data, same number of steps, same rates."""
    lisa, lang_dt = (read_training(folder / f"{name}.yaml") for name in ("lisa", "lang_dt"))

    for name in ("batch_size", "steps", "seed", "dataset", "env"):
        assert getattr(lisa, name) == getattr(lang_dt, name), name
    for name in (
        "optimizer_lr",
        "scheduler",
        "scheduler_warmup_steps",
        "dim_model",
        "n_heads",
        "dropout",
        "language_encoder",
    ):
        assert getattr(lisa.policy, name) == getattr(lang_dt.policy, name), name
