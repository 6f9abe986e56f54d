"""What a tabletop tells policies about itself, so that they can compare it with their training data."""

from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import ProcessorStep
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_STATE

from lerobot_lisa.envs.lorel.state import IGNORED_ACTIONS
from lerobot_lisa.feature_info import KEY, Fact


class TellFacts(ProcessorStep):
    """Adds the arm, the image quality and the ignored actions to the `info` of every observation."""

    def __init__(self, arm: str, image_quality: str | None) -> None:
        """Note them; `image_quality` is None where there are no images."""
        self._facts = {OBS_STATE: {"arm": Fact(arm, "--env.arm")}, ACTION: {"ignored": Fact(list(IGNORED_ACTIONS))}}
        if image_quality is not None:
            self._facts[OBS_IMAGE] = {"quality": Fact(image_quality, "--env.image_quality")}

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Add them."""
        info = {**(transition.get(TransitionKey.INFO) or {}), KEY: self._facts}
        return {**transition, TransitionKey.INFO: info}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Leave the features as they are."""
        return features
