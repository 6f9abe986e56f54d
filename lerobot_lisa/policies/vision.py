"""Vision backbones by name: a resnet of torchvision, or a vision model of `transformers` from the Hub or a folder."""

from typing import Any

import torch
from lerobot.configs import FeatureType

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.backbones import Backbone, FrozenBackbone, ResnetMap, TransformersMap
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.pretrained import VISION, fetched, note, rebuilt

IMAGENET = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225])  # mean and deviation
_SIDE = {False: 7, True: 4}  # patches along a side; those of a frozen backbone wait on disk, for each frame


def make_backbone(config: EpisodePolicyConfig) -> Backbone | None:
    """The configured one, frozen or not; None: three convolutions.

    A new policy takes its weights from torchvision, the Hub or a folder, and notes the architecture of a `transformers`
    model in `config.vision_model`; a loaded one builds from that note and gets its weights from the checkpoint.

    Raises:
        UserError: It is not there, or cannot look at such pictures.
    """
    if config.vision_backbone is None:
        return None
    for key, feature in (config.input_features or {}).items():
        if feature.type is FeatureType.VISUAL and feature.shape[0] != 3:
            raise UserError(f"{_option(config)} needs 3 channels, `{key}` has {feature.shape[0]}")
    name = config.vision_backbone
    return _of_torchvision(config, name) if of_torchvision(name) else _of_transformers(config, name)


def of_torchvision(name: str) -> bool:
    """Whether a backbone is one of torchvision's, whose architecture needs no note."""
    from torchvision.models import list_models  # slow to import, and only policies with a backbone need it

    return name in list_models()


def _of_torchvision(config: EpisodePolicyConfig, name: str) -> Backbone:
    import torchvision

    try:
        model = torchvision.models.get_model(name, weights=config.pretrained_backbone_weights)
    except (ValueError, KeyError) as error:  # its words for an unknown model or weights
        raise UserError(f"{_option(config)}: {error}: choose a resnet of torchvision, a Hub id or a folder") from error
    if not isinstance(getattr(model, "fc", None), torch.nn.Linear) or not hasattr(model, "layer4"):
        raise UserError(f"{_option(config)} has no final layer called fc: choose a resnet, a Hub id or a folder")
    found = ResnetMap(model)
    return _kind(config)(found, found.features, *IMAGENET, side=_SIDE[config.freeze_vision_backbone])


def _of_transformers(config: EpisodePolicyConfig, name: str) -> Backbone:
    if config.vision_model is None:
        model = fetched(name, VISION, _missing(name))
        config.vision_model = {**note(model), **_pictures_of(name, model)}
    else:
        model = rebuilt({k: v for k, v in config.vision_model.items() if k not in PICTURES}, VISION, "vision_model")
    noted = config.vision_model
    found = TransformersMap(model, _pair(noted.get("patch_size")))
    size = _pair(noted.get("picture_size"))
    features = _try(found, size or (64, 64), config)
    scale = (noted.get("image_mean", IMAGENET[0]), noted.get("image_std", IMAGENET[1]))
    return _kind(config)(found, features, *scale, size, _SIDE[config.freeze_vision_backbone])


PICTURES = ("image_mean", "image_std", "picture_size")
"""What `vision_model` notes besides the model's own configuration."""


def _pictures_of(name: str, model: Any) -> dict[str, Any]:
    """What pictures a model was trained on, as far as anybody says so."""
    from transformers.image_processing_base import ImageProcessingMixin

    try:
        said, _ = ImageProcessingMixin.get_image_processor_dict(name)
    except (OSError, ValueError):
        said = {}
    size = said.get("crop_size") or said.get("size") or getattr(model.config, "image_size", None)
    if isinstance(size, dict):
        size = [size["height"], size["width"]] if "height" in size else size.get("shortest_edge")
    mean, std = said.get("image_mean", IMAGENET[0]), said.get("image_std", IMAGENET[1])
    return {"image_mean": list(mean), "image_std": list(std), "picture_size": list(_pair(size) or ())}


def _pair(size: Any) -> tuple[int, int] | None:
    """Height and width."""
    if not size:
        return None
    return (int(size), int(size)) if isinstance(size, int) else (int(size[0]), int(size[1]))


@torch.no_grad()
def _try(model: TransformersMap, size: tuple[int, int], config: EpisodePolicyConfig) -> int:
    """Look at a picture; returns how many features there are."""
    training = model.training
    try:
        whole, last = model.eval()(torch.zeros(1, 3, *size))
        if last.dim() != 4 or (whole is not None and whole.shape != last.shape[:2]):
            raise ValueError("it makes no map of the picture")
    except Exception as error:  # every model says it in its own way
        reason = " ".join(str(error).split())
        raise UserError(
            f"{_option(config)}: a {type(model.model).__name__} cannot look at pictures alone ({reason:.150}): choose "
            "a vision model, such as DINOv2, SigLIP or CLIP, or a resnet of torchvision"
        ) from error
    model.train(training)
    return int(last.shape[1])


def _missing(name: str) -> str:
    return (
        f"vision backbone {name!r} is neither a folder nor to be had from the Hub (offline?): pass a local path, a "
        "resnet of torchvision, or --policy.vision_backbone=null for three convolutions that need no download"
    )


def _kind(config: EpisodePolicyConfig) -> type[Backbone]:
    return FrozenBackbone if config.freeze_vision_backbone else Backbone


def _option(config: EpisodePolicyConfig) -> str:
    return f"--policy.vision_backbone={config.vision_backbone}"
