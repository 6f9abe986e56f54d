"""A checkpoint of another policy is refused in one line that names both."""

from pathlib import Path

import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies.factory import get_policy_class, make_policy

import lerobot_lisa  # noqa: F401  registers the policies
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

CONFIGS: dict[str, type[PreTrainedConfig]] = {"lisa": LisaConfig, "lang_dt": LangDTConfig}


@pytest.mark.parametrize(("kind", "other"), [("lisa", "lang_dt"), ("lang_dt", "lisa")])
def test_from_pretrained(kind: str, other: str, symbolic: Path, tmp_path: Path) -> None:
    config = CONFIGS[kind](dim_model=32, n_heads=2, language_encoder="words", device="cpu", push_to_hub=False)
    make_policy(config, ds_meta=LeRobotDatasetMetadata("local/tiny", root=symbolic)).save_pretrained(tmp_path)

    with pytest.raises(UserError, match=rf"cannot load a {kind} policy .* choose a {other} checkpoint") as refused:
        get_policy_class(other).from_pretrained(tmp_path)
    assert "\n" not in str(refused.value)
