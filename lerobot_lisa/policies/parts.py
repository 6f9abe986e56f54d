"""Build the network parts that both policies share from a policy's settings."""

from collections.abc import Container, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from torch import Tensor, nn

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.actions import ActionHead, CategoricalHead
from lerobot_lisa.networks.backbones import Backbone
from lerobot_lisa.networks.language import LanguageEncoder, PretrainedEncoder, WordEncoder
from lerobot_lisa.networks.observations import AskingSpec, ObservationEncoder, ObservationSpec
from lerobot_lisa.networks.parts import PartAttention
from lerobot_lisa.networks.real_actions import BinsHead, MeanHead, MixtureHead
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import missing_language_encoder
from lerobot_lisa.policies.episode_settings import SYMBOLS, WORDS
from lerobot_lisa.policies.lexicon import Symbols, symbol_names, symbol_words, symbols_of
from lerobot_lisa.policies.pretrained import TEXT, fetched, note, rebuilt

KINDS = {FeatureType.ENV: "symbols", FeatureType.STATE: "state", FeatureType.VISUAL: "image"}


def make_observation_encoder(
    config: EpisodePolicyConfig,
    language: LanguageEncoder,
    backbone: Backbone | None = None,
    without: Container[str] = (),
) -> ObservationEncoder:
    """One encoder over all of the policy's observation features.

    Args:
        config: The policy's.
        language: Whose words things are asked by.
        backbone: From `make_backbone`. A frozen one stays outside: the encoder gets what it says of pictures.
        without: Features that something else sees with.
    """
    features = {key: feature for key, feature in (config.input_features or {}).items() if key not in without}
    specs = {key: _spec(config, key, feature, backbone) for key, feature in features.items()}
    asking = AskingSpec(language.encoder.width, config.dim_model // 2, language.encoder.whole)
    own = None if config.freeze_vision_backbone else deepcopy(backbone)
    return ObservationEncoder(specs, config.dim_model, own, asking if config.ask_observations else None)


def _spec(config: EpisodePolicyConfig, key: str, feature: PolicyFeature, backbone: Backbone | None) -> ObservationSpec:
    if feature.type is FeatureType.VISUAL and backbone is not None and config.freeze_vision_backbone:
        return ObservationSpec("features", backbone.shape)
    spoken = named_symbols(config)[key]
    names = None if spoken is None else replace(symbol_names(spoken, thing_names(config)), used=config.names)
    return ObservationSpec(KINDS[feature.type], tuple(feature.shape), SYMBOLS, names)  # type: ignore[arg-type]


def named_symbols(config: EpisodePolicyConfig) -> dict[str, Symbols | None]:
    """What the symbols of each observation feature are called; None for those without names."""
    info = config.feature_info or {}
    return {
        key: symbols_of(key, feature.shape, info.get(key, {})) if feature.type is FeatureType.ENV else None
        for key, feature in (config.input_features or {}).items()
    }


def thing_names(config: EpisodePolicyConfig) -> list[str]:
    """What symbols are called, as far as instructions speak of it and the policy is to know."""
    if not config.names:
        return []
    words = [word for symbols in named_symbols(config).values() if symbols for word in symbol_words(symbols)]
    return [word for word in dict.fromkeys(words) if word in config.lexicon]


def make_part_attention(config: EpisodePolicyConfig, language: LanguageEncoder, asked: int) -> PartAttention | None:
    """Questions of width `asked` to the parts of what is seen; None if the configuration wants none."""
    if not config.ask_observations:
        return None
    width = config.dim_model
    return PartAttention(asked, language.encoder.width, width // 2, width, width, language.encoder.whole)


def make_action_head(config: EpisodePolicyConfig, bounds: Tensor) -> ActionHead:
    """Categorical or real-valued, as the dataset's actions are; `bounds` (2, A) are the least and greatest of them."""
    if config.action_classes:
        return CategoricalHead(config.dim_model, config.action_classes, config.action_temperature)
    weights = action_weights(config)
    if config.action_head == "bins":
        return BinsHead(config.dim_model, weights, bounds, config.action_bins, config.action_temperature)
    if config.action_head == "mixture":
        return MixtureHead(config.dim_model, weights, bounds, config.action_components, config.action_temperature)
    return MeanHead(config.dim_model, weights, bounds, config.action_amplification)


def action_weights(config: EpisodePolicyConfig) -> Tensor:
    """(A,) of real-valued actions: 0 for dimensions that the environment ignores, else 1."""
    weights = torch.ones(config.action_feature.shape[0])  # validate_features has seen to it
    weights[config.ignored_action_dimensions or []] = 0
    return weights


def make_last_head(config: EpisodePolicyConfig, bounds: Tensor) -> ActionHead:
    """The same for a policy that looks at no earlier action, and so needs no vectors of actions."""
    head = make_action_head(config, bounds)
    del head.embedding
    return head


def make_language_encoder(config: EpisodePolicyConfig) -> LanguageEncoder:
    """The built-in word-level encoder or a pretrained one.

    A new policy takes a pretrained encoder's weights from the Hub or a folder and notes its architecture in
    `config.language_model`; a loaded one builds from that note and gets its weights from the checkpoint.
    """
    names = [config.lexicon[name] for name in thing_names(config)]
    if config.language_encoder == WORDS:
        return LanguageEncoder(WordEncoder(len(config.vocabulary) + 2, config.dim_model), config.dim_model, names)
    if config.language_model is None:
        model = _fetch(config.language_encoder)
        config.language_model = note(model)
    else:
        model = rebuilt(config.language_model, TEXT, "language_model")
    encoder = PretrainedEncoder(model, config.freeze_language_encoder)
    return LanguageEncoder(encoder, config.dim_model, names)


def parameter_group(name: str, modules: Sequence[nn.Module | None], rate: float) -> dict[str, Any]:
    """What the optimiser gets for modules that learn at the same rate."""
    there = nn.ModuleList(module for module in modules if module is not None)
    return {"name": name, "params": list(there.parameters()), "lr": rate}


def _fetch(name: str) -> Any:
    model: Any = fetched(name, TEXT, missing_language_encoder(name))
    tokens = torch.ones(1, 2, dtype=torch.long)
    try:
        with torch.no_grad():
            model(input_ids=tokens, attention_mask=tokens).last_hidden_state.view(1, 2, model.config.hidden_size)
    except Exception as error:  # every model says it in its own way
        raise UserError(
            f"language encoder {name}: a {type(model).__name__} cannot read instructions alone: choose an encoder of "
            "text, such as DistilBERT, T5's encoder or CLIP's text model"
        ) from error
    return model
