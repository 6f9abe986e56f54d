"""The one way in which the analysis commands load a policy: checked first, then built by LeRobot.

config = load_config("outputs/lisa/checkpoints/last/pretrained_model", ["--action_temperature=0"])
policy, preprocess, postprocess, identity = load_checkpoint(config, env=BabyAIEnvConfig())
"""

from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from lerobot.envs.configs import EnvConfig
from lerobot.policies.factory import get_policy_class
from lerobot.utils.constants import ACTION

from lerobot_lisa.checkpoints.files import CONFIG, WEIGHTS, find, refusing
from lerobot_lisa.checkpoints.identity import Identity, identity_of
from lerobot_lisa.checkpoints.pipelines import blank, load_pipelines, stats_of
from lerobot_lisa.checkpoints.settings import load_config
from lerobot_lisa.checkpoints.weights import check_weights
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig

if TYPE_CHECKING:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    from lerobot_lisa.policies.base_modeling import EpisodePolicy

__all__ = ["Checkpoint", "load_checkpoint", "load_config"]


class Checkpoint(NamedTuple):
    """A policy ready to act.

    Attributes:
        policy: In evaluation mode, on its configuration's device.
        preprocess: Its preprocessor.
        postprocess: Its postprocessor.
        identity: What tells it from other checkpoints.
    """

    policy: "EpisodePolicy"
    preprocess: Any
    postprocess: Any
    identity: Identity


def load_checkpoint(
    config: EpisodePolicyConfig, env: EnvConfig | None = None, dataset: "LeRobotDatasetMetadata | None" = None
) -> Checkpoint:
    """Load a policy and its pipelines; nothing in the checkpoint is run, and nothing outside it is read.

    Args:
        config: From `load_config`; stays as it is.
        env: Where the policy is to act.
        dataset: For a policy that reads whole episodes of a dataset with the features it was trained on.

    Raises:
        UserError: Something is missing, broken or not finite, or the policy does not fit the environment.
    """
    files, config = find(str(config.pretrained_path), config.pretrained_revision), deepcopy(config)
    if env is not None:
        _check_actions(config, env)
    config.pretrained_path = None  # nobody trains it on: it learns no new words of the dataset
    preprocess, postprocess = load_pipelines(files, config)
    weights = files.path(WEIGHTS)
    made = get_policy_class(config.type)
    with refusing(f"{files.path(CONFIG)} builds no policy"):
        with torch.device("meta"):  # nothing is allocated before the weights are seen to be what is to be built
            empty = made(deepcopy(config))
        check_weights(weights, empty)
        known = {} if dataset is None else {"dataset_stats": stats_of(preprocess), "dataset_meta": dataset}
        policy = made.from_pretrained(weights.parent, config=config, **known).eval()
    with refusing(f"--policy.path={files.name} cannot act"):
        _try_to_act(policy, preprocess, postprocess)
    return Checkpoint(policy, preprocess, postprocess, identity_of(files))


def _try_to_act(policy: "EpisodePolicy", preprocess: Any, postprocess: Any) -> None:
    """Take one step, and forget it: finite weights and settings may still give numbers that are not."""
    policy.reset()
    action = postprocess(policy.select_action(preprocess(blank(preprocess, policy.config))))
    if not action.isfinite().all():
        raise ValueError("its action is not finite")
    policy.reset()
    policy.rollouts = 0


def _check_actions(config: EpisodePolicyConfig, env: EnvConfig) -> None:
    taken = next((feature.shape for key, feature in env.features.items() if env.features_map[key] == ACTION), None)
    shape = config.action_feature.shape
    if taken is not None and tuple(taken) != tuple(shape):
        raise UserError(
            f"--policy.path={config.pretrained_path} acts with {shape[0]} numbers, --env.type={env.type} takes "
            f"{taken[0]}: the policy was trained for another world; choose that one"
        )
