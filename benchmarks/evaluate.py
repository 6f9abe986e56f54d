"""Evaluation of many episodes side by side against one environment at a time, through LeRobot's own rollout."""

import argparse
from collections import Counter
from collections.abc import Callable
from typing import Any

from lerobot.envs.factory import make_env_pre_post_processors
from lerobot.scripts.lerobot_eval import rollout

from benchmarks.measuring import Contest, Seconds, measure
from benchmarks.policies import NAMES, Training
from benchmarks.table import Row, ratio_row
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig

EPISODES, ALONE, STEPS, FIRST_SEED = 100, 5, 100, 1000


def rows(options: argparse.Namespace) -> list[Row]:
    return [_row(kind, options) for kind in NAMES]


def _row(kind: str, options: argparse.Namespace) -> Row:
    training = Training(kind, options)
    training.policy.forward(training.batch(16))  # k-means places the codes
    together, alone = _Evaluation(training, EPISODES), _Evaluation(training, 1)
    ours: list[Seconds] = []
    theirs: list[Seconds] = []
    whole: list[Seconds] = []
    for _ in range(options.repeats):
        whole.append(measure(lambda: together.run(1)))
        ours.append(Seconds(together.spent["policy"], together.spent["policy wall"]).per(EPISODES))
        alone.run(ALONE)
        theirs.append(Seconds(alone.spent["policy"], alone.spent["policy wall"]).per(ALONE))
    shares = {part: together.spent[part] / whole[-1].cpu for part in ("policy", "simulator")}
    return ratio_row(
        f"evaluating {EPISODES} GoToSeq episodes in a batch, {NAMES[kind]}'s share",
        "one environment at a time",
        5,
        Contest(ours, theirs),
        "episodes",
        **{"steps of each": STEPS, "CPU-seconds for all": whole[-1].cpu},
        **{f"share of the {part}": share for part, share in shares.items()},
        **{"share of LeRobot's loop": 1 - sum(shares.values())},
    )


class _Evaluation:
    """LeRobot's rollout over a batch of environments, with a clock at its two sides: policy and simulator."""

    def __init__(self, training: Training, environments: int) -> None:
        self.training, self.environments = training, environments
        config = BabyAIEnvConfig(task="GoToSeq", max_episode_steps=STEPS)
        self.env = config.create_envs(environments)["babyai"][0]
        self.env_processors = make_env_pre_post_processors(config, training.policy.config)
        self.spent: Counter[str] = Counter()

    def run(self, batches: int) -> None:
        """Evaluate some batches; `spent` then holds the seconds of their parts."""
        self.spent.clear()
        policy, env = self.training.policy.eval(), self.env
        for name in ("select_action", "step", "reset"):  # a timed method hides the one of the class
            owner: Any = policy if name == "select_action" else env
            vars(owner).pop(name, None)
            setattr(owner, name, self._timed("policy" if owner is policy else "simulator", getattr(owner, name)))
        preprocess = self._timed("policy", self.training.preprocessor)
        postprocess = self._timed("policy", self.training.postprocessor)
        for batch in range(batches):
            first = FIRST_SEED + batch * self.environments
            seeds = list(range(first, first + self.environments))
            rollout(env, policy, *self.env_processors, preprocess, postprocess, seeds=seeds)
        vars(policy).pop("select_action")

    def _timed(self, part: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **keywords: Any) -> Any:
            start = Seconds.now()
            result = work(*arguments, **keywords)
            taken = Seconds.now().since(start)
            self.spent[part] += taken.cpu
            self.spent[f"{part} wall"] += taken.wall
            return result

        return timed
