"""The LOReL-Planner policy in LeRobot's protocol; the method itself is `lerobot_lisa.networks.lorel_planner`."""

from math import prod

import torch
from torch import Tensor

from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.cross_entropy import CrossEntropySearch
from lerobot_lisa.networks.lorel_planner import LorelPlanner, PlannedActions
from lerobot_lisa.networks.packing import Packing
from lerobot_lisa.policies.baseline_modeling import BaselinePolicy
from lerobot_lisa.policies.known_losses import Losses
from lerobot_lisa.policies.lorel_planner.configuration_lorel_planner import LorelPlannerConfig
from lerobot_lisa.policies.parts import action_weights, make_language_encoder


class LorelPlannerPolicy(BaselinePolicy):
    """LOReL's planner on states: a learned reward, a learned model of the world, and the cross-entropy method."""

    config_class = LorelPlannerConfig
    name = "lorel_planner"
    loss_name = "model_loss"
    config: LorelPlannerConfig
    network: LorelPlanner

    def make_network(self, action_bounds: Tensor, backbone: Backbone | None) -> LorelPlanner:
        """Model, judge and search of the configured sizes."""
        config = self.config
        return LorelPlanner(
            language=make_language_encoder(config),
            keys=list(config.input_features),
            size=sum(prod(feature.shape) for feature in config.input_features.values()),
            width=config.dim_model,
            dropout=config.dropout,
            head=PlannedActions(action_weights(config), action_bounds),
            steps=config.plan_steps,
            search=CrossEntropySearch(config.plan_samples, config.plan_elites, config.plan_rounds),
        )

    def frame_losses(
        self, tokens: Tensor, tokens_valid: Tensor, frames: dict[str, Tensor], actions: Tensor, packing: Packing
    ) -> Losses:
        """Errors (N,) of the states that the model predicts, and the judge's loss."""
        predicted, judged = self.network(tokens, tokens_valid, frames, actions, packing)
        errors = (predicted - self.network.state(frames).roll(-1, 0)).square().mean(-1)
        last = torch.zeros_like(errors, dtype=torch.bool)
        last[(packing.lengths.cumsum(0) - 1).to(last.device)] = True
        errors = errors.masked_fill(last, 0)  # what follows is not known
        return errors, judged.judge_loss, judged._asdict()

    def _begin(self, tokens: Tensor, valid: Tensor) -> None:
        super()._begin(tokens, valid)
        self._history.generator = self._generator
