"""What to evaluate, as `lerobot-eval` takes it, and one batch of episodes run by LeRobot's own code and recorded."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy, deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa
from lerobot.configs import FeatureType, PreTrainedConfig, parser
from lerobot.envs.configs import EnvConfig

from lerobot_lisa.analysis.commands import check_number
from lerobot_lisa.analysis.recording.environment import Batch, Insight, Looks, RecordingEnv, Watcher
from lerobot_lisa.analysis.recording.traces import EPISODES, KEY
from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.envs.gl import choose_gl
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig

if TYPE_CHECKING:
    from lerobot_lisa.policies.base_modeling import EpisodePolicy


@dataclass(kw_only=True)
class CheckpointConfig:
    """Which checkpoint; options are called as in `lerobot-eval`, with all of `--policy.*`."""

    policy: PreTrainedConfig | None = None
    """Checkpoint, from `--policy.path`, with overrides."""

    def __post_init__(self) -> None:
        """Read the checkpoint's configuration, as `lerobot-eval` does."""
        if path := parser.get_path_arg("policy"):
            self.policy = load_config(path, parser.get_cli_overrides("policy") or [])
        if self.policy is None or not self.policy.pretrained_path:
            raise UserError("--policy.path is missing: name a checkpoint's folder (pretrained_model) or its Hub id")

    @property
    def checkpoint(self) -> str:
        """The policy's folder or Hub id."""
        assert self.policy is not None  # refused above
        return str(self.policy.pretrained_path)

    @property
    def revision(self) -> str | None:
        """The commit of the Hub's repository that the policy is from; None for a folder."""
        assert self.policy is not None  # refused above
        return self.policy.pretrained_revision

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        """LeRobot's parser takes `--policy.path` out before draccus sees it."""
        return ["policy"]


@dataclass(kw_only=True)
class EvaluationConfig(CheckpointConfig):
    """What to evaluate; options are called as in `lerobot-eval`, with all of `--policy.*` and `--env.*`."""

    env: EnvConfig
    """Environment, by `--env.type` and what belongs to it."""

    n_episodes: int = 50
    """Episodes of each task."""

    batch_size: int = 50
    """Environments side by side. Drawn actions depend on it, as in `lerobot-eval`."""

    use_async_envs: bool = False
    """Whether each environment gets a process of its own."""

    seed: int = 1000
    """Seed of each task's first episode; the others count up."""

    output_dir: Path = field(default_factory=lambda: Path("outputs/report"))
    """Where everything goes; an evaluation found there is used, or gone on with, if it is the same."""

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        check_number("n_episodes", self.n_episodes, 1, 1_000_000)
        check_number("batch_size", self.batch_size, 1, 10_000)
        check_number("seed", self.seed, 0, 2**32 - self.n_episodes)  # what NumPy's global seed can be
        self.batch_size = min(self.batch_size, self.n_episodes)


def lisa_config(config: CheckpointConfig) -> LisaConfig:
    """The checkpoint's configuration.

    Raises:
        UserError: It is no LISA policy or one with continuous skills, so there are no skill codes.
    """
    if isinstance(config.policy, LisaConfig):
        if not config.policy.n_codes:
            raise UserError(f"--policy.path={config.checkpoint} has continuous skills: there are no skill codes")
        return config.policy
    kind = config.policy.type if config.policy else "no"
    raise UserError(f"--policy.path={config.checkpoint} is a {kind} policy: only lisa policies have skill codes")


def steered[Config: CheckpointConfig](config: Config, plan: str | None) -> Config:
    """The same policy under a plan of skill codes, such as "14" or "14*20,2*20"; None: under its skill predictor.

    Raises:
        UserError: The policy has no skill codes. Whether it has those of the plan shows when it is loaded.
    """
    changed = copy(config)
    changed.policy = deepcopy(lisa_config(config))
    changed.policy.skill_plan = plan
    return changed


def code_labels(policy: Any) -> list[str]:
    """What a policy's K skill codes are called: their words, such as "3 red ball", or numbers; none if it has none."""
    named = getattr(policy, "code_labels", None)
    return named or [str(code) for code in range(getattr(policy, "n_codes", 0))]


class Evaluation(NamedTuple):
    """Everything that LeRobot's evaluation takes, loaded.

    Attributes:
        policy: In evaluation mode.
        envs: Vectorised environments by task group and task id, made at their first use.
        pipelines: LeRobot's names and objects of the four pre- and postprocessors.
    """

    policy: "EpisodePolicy"
    envs: Mapping[str, Mapping[int, Any]]
    pipelines: Mapping[str, Any]


def load(config: EvaluationConfig) -> Evaluation:
    """Load a policy with its pipelines and make its environments, as `lerobot-eval` does but for checking more.

    Raises:
        UserError: The checkpoint or the environment cannot be used.
    """
    from lerobot.envs import make_env_pre_post_processors

    envs = _make_envs(config)
    assert config.policy is not None  # refused by EvaluationConfig
    policy, preprocess, postprocess, _ = load_checkpoint(config.policy, config.env)
    before, after = make_env_pre_post_processors(env_cfg=config.env, policy_cfg=config.policy)
    pipelines = {
        "env_preprocessor": before,
        "env_postprocessor": after,
        "preprocessor": preprocess,
        "postprocessor": postprocess,
    }
    return Evaluation(policy, envs, pipelines)


def _make_envs(config: EvaluationConfig) -> Mapping[str, Mapping[int, Any]]:
    """LeRobot's environments; those of worlds that are not ours may fail in any way."""
    from lerobot.envs import make_env

    choose_gl()  # without a display, worlds of MuJoCo fail where nobody has chosen
    try:
        envs = make_env(config.env, n_envs=config.batch_size, use_async_envs=config.use_async_envs)
    except UserError:
        raise
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        task = f" --env.task={config.env.task}" if config.env.task else ""
        raise UserError(f"LeRobot cannot make --env.type={config.env.type}{task}: {said[:300]}") from error
    shown = any(feature.type is FeatureType.VISUAL for feature in config.env.features.values())
    if shown and "mujoco" in sys.modules:
        from lerobot_lisa.envs.engine import check_drawing

        check_drawing(config.env.type, "where --env.obs_type has them")
    return envs


def run_batch(
    config: EvaluationConfig,
    evaluation: Evaluation,
    batch: Batch,
    rollout: int = 0,
    watchers: Sequence[Watcher] = (),
) -> tuple[pa.Table, pa.Table]:
    """One batch of episodes of a task, run by LeRobot.

    Args:
        config: Of the evaluation.
        evaluation: Loaded.
        batch: Which episodes; at most `config.batch_size`, and none beyond `config.n_episodes`.
        rollout: How many batches `lerobot-eval` would have run before; drawn actions depend on it.
        watchers: Told about every step.

    Returns:
        Tables of its steps and of its episodes, columns of `STEPS` and `EPISODES`.
    """
    import torch
    from lerobot.scripts.lerobot_eval import eval_policy

    policy, episodes = evaluation.policy, min(config.batch_size, config.n_episodes - batch.first)
    policy.rollouts = rollout
    env = evaluation.envs[batch.group][batch.task_id]
    insight = Insight(lambda: getattr(policy, "skill_codes", None), code_labels(policy), lambda: _looks(policy))
    recording = RecordingEnv(env, insight, batch, episodes, watchers)
    with torch.no_grad(), _autocast(policy.config):
        seed = config.seed + batch.first
        outcome = eval_policy(recording, policy, **evaluation.pipelines, n_episodes=episodes, start_seed=seed)
    recording.end_rollout()
    steps = recording.trace()
    return steps, _summarise(steps, [episode["success"] for episode in outcome["per_episode"]])


def _looks(policy: Any) -> Looks | None:
    looks = getattr(policy, "looks", None)
    if looks is None:
        return None
    attention = {key: places.float().cpu().numpy() for key, places in looks.items()}
    return Looks(attention, policy.questions.cpu().numpy())


def _summarise(steps: pa.Table, successes: Sequence[bool]) -> pa.Table:
    """The episodes of a batch's steps, and what LeRobot says of them, in order."""
    grouped = steps.to_pandas().groupby(KEY, sort=True, observed=True)
    episodes = grouped.agg(seed=("seed", "first"), instruction=("instruction", "first"), steps=("step", "size"))
    episodes["success"] = list(successes)
    return pa.Table.from_pandas(episodes.reset_index(), EPISODES, preserve_index=False)


def _autocast(config: PreTrainedConfig) -> AbstractContextManager[Any]:
    import torch

    return torch.autocast(device_type=torch.device(config.device).type) if config.use_amp else nullcontext()
