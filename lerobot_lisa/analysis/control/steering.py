"""An evaluation whose policy follows a plan of skill codes instead of its skill predictor."""

from copy import copy, deepcopy

from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig
from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.skill_plan import read_plan
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig


def lisa_config(config: EvaluationConfig) -> LisaConfig:
    """The checkpoint's configuration.

    Raises:
        UserError: It is no LISA policy or one with continuous skills, so there are no skill codes.
    """
    if isinstance(config.policy, LisaConfig):
        if config.policy.continuous_skills:
            raise UserError(f"--policy.path={config.checkpoint} has continuous skills: there are no skill codes")
        return config.policy
    kind = config.policy.type if config.policy else "no"
    raise UserError(f"--policy.path={config.checkpoint} is a {kind} policy: only lisa policies have skill codes")


def steered[Config: EvaluationConfig](config: Config, plan: str | None) -> Config:
    """The same evaluation under a plan, such as "14" or "14*20,2*20"; None: under the skill predictor.

    Raises:
        UserError: The policy has no skill codes, or not those of the plan.
    """
    policy = lisa_config(config)
    if plan is not None:
        read_plan(plan, policy.codebook_size)
    changed = copy(config)
    changed.policy = deepcopy(policy)
    changed.policy.skill_plan = plan
    return changed
