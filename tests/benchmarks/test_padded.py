"""The plain padded implementation that the training step is measured against computes the same loss and gradients."""

import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors

from benchmarks.model import padded_batch, padded_copy
from lerobot_lisa.policies.lang_dt.configuration_lang_dt import LangDTConfig
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

SMALL = {
    "dim_model": 32, "n_heads": 2, "dropout": 0.0, "language_encoder": "words", "device": "cpu", "push_to_hub": False,
    "ask_observations": False, "augment": False,
}  # fmt: skip
CONFIGS = {
    "lisa": lambda: LisaConfig(horizon=3, codebook_size=5, copy_words=False, quantizer_warmup_steps=0, **SMALL),
    "lang_dt": lambda: LangDTConfig(**SMALL),
}


@pytest.mark.parametrize("kind", CONFIGS)
@pytest.mark.parametrize("data", ["symbolic", "continuous"])
def test_packed_loss_is_padded_loss(kind: str, data: str, request: pytest.FixtureRequest) -> None:
    dataset = LeRobotDataset("local/tiny", root=request.getfixturevalue(data))
    policy = make_policy(CONFIGS[kind](), ds_meta=dataset.meta).train()
    preprocess, _ = make_pre_post_processors(policy.config, dataset_stats=dataset.meta.stats)
    starts = [0, *dataset.meta.episodes["dataset_from_index"]]  # an episode twice
    batch = preprocess(torch.utils.data.default_collate([dataset[start] for start in starts]))
    policy.forward(batch)  # k-means places the codes
    plain = padded_copy(policy).train()

    loss, _ = policy.forward(batch)
    plain_loss = plain(padded_batch(policy, batch))

    torch.testing.assert_close(loss, plain_loss, atol=1e-6, rtol=1e-6)
    loss.backward()
    plain_loss.backward()
    ours, theirs = (dict(network.named_parameters()) for network in (policy.network, plain))
    name = "language.encoder.embedding.weight"  # what the gradient reaches last
    torch.testing.assert_close(ours[name].grad, theirs[name].grad, atol=1e-6, rtol=1e-4)
