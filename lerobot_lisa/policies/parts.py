"""Build the network parts that both policies share from a policy's settings."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from lerobot.configs import FeatureType
from torch import Tensor, nn

from lerobot_lisa.errors import UserError
from lerobot_lisa.networks.actions import ActionHead, CategoricalHead
from lerobot_lisa.networks.language import LanguageEncoder, PretrainedEncoder, WordEncoder
from lerobot_lisa.networks.observations import AskingSpec, ObservationEncoder, ObservationSpec
from lerobot_lisa.networks.parts import PartAttention
from lerobot_lisa.networks.real_actions import BinsHead, MeanHead, MixtureHead
from lerobot_lisa.policies.base_configuration import SYMBOLS, WORDS, EpisodePolicyConfig
from lerobot_lisa.policies.base_processor import missing_language_encoder
from lerobot_lisa.policies.lexicon import Symbols, symbol_names, symbol_words, symbols_of

MOST_PARAMETERS = 2_000_000_000  # of a language encoder
KINDS = {FeatureType.ENV: "symbols", FeatureType.STATE: "state", FeatureType.VISUAL: "image"}


def make_observation_encoder(config: EpisodePolicyConfig, language: LanguageEncoder) -> ObservationEncoder:
    """One encoder over all of the policy's observation features.

    Raises:
        UserError: The image backbone is unknown or does not fit the images.
    """
    named = named_symbols(config)
    specs = {
        key: ObservationSpec(
            KINDS[feature.type],  # type: ignore[arg-type]
            tuple(feature.shape),
            SYMBOLS,
            None if (spoken := named[key]) is None else symbol_names(spoken, thing_names(config)),
        )
        for key, feature in (config.input_features or {}).items()
    }
    asking = AskingSpec(language.encoder.width, config.dim_model // 2, language.encoder.whole)
    try:
        return ObservationEncoder(
            specs,
            config.dim_model,
            config.vision_backbone,
            config.pretrained_backbone_weights,
            asking if config.ask_observations else None,
        )
    except (ValueError, KeyError) as error:  # torchvision's words for an unknown model or weights
        raise UserError(f"--policy.vision_backbone={config.vision_backbone}: {error}") from error


def named_symbols(config: EpisodePolicyConfig) -> dict[str, Symbols | None]:
    """What the symbols of each observation feature are called; None for those without names."""
    info = config.feature_info or {}
    return {
        key: symbols_of(key, feature.shape, info.get(key, {})) if feature.type is FeatureType.ENV else None
        for key, feature in (config.input_features or {}).items()
    }


def thing_names(config: EpisodePolicyConfig) -> list[str]:
    """What symbols are called, as far as instructions speak of it."""
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
    size = config.action_feature.shape[0]  # validate_features has seen to it
    weights = torch.ones(size)
    weights[config.ignored_action_dimensions or []] = 0
    if config.action_head == "bins":
        return BinsHead(config.dim_model, weights, bounds, config.action_bins, config.action_temperature)
    if config.action_head == "mixture":
        return MixtureHead(config.dim_model, weights, bounds, config.action_components, config.action_temperature)
    return MeanHead(config.dim_model, weights, bounds, config.action_amplification)


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
        config.language_model = _jsonable(model.config.to_dict())
    else:
        model = _rebuild(config.language_model)
    encoder = PretrainedEncoder(model, config.freeze_language_encoder)
    return LanguageEncoder(encoder, config.dim_model, names)


def parameter_group(name: str, modules: Sequence[nn.Module | None], rate: float) -> dict[str, Any]:
    """What the optimiser gets for modules that learn at the same rate."""
    there = nn.ModuleList(module for module in modules if module is not None)
    return {"name": name, "params": list(there.parameters()), "lr": rate}


def _fetch(name: str) -> Any:
    try:
        model = _text_encoder(lambda factory: factory.from_pretrained(name, trust_remote_code=False))
    except (OSError, ValueError) as error:
        raise UserError(missing_language_encoder(name)) from error
    _check_size(model)
    tokens = torch.ones(1, 2, dtype=torch.long)
    try:
        with torch.no_grad():
            model(input_ids=tokens, attention_mask=tokens).last_hidden_state.view(1, 2, model.config.hidden_size)
    except Exception as error:  # every model says it in its own way
        raise UserError(
            f"language encoder {name}: a {type(model).__name__} cannot read instructions alone: choose an encoder of "
            "text, such as DistilBERT, T5's encoder or CLIP's text model"
        ) from error
    for parameter in model.parameters():  # mapped from a file, at any address, products differ in the last digit
        parameter.data = parameter.data.clone()
    return model


def _rebuild(noted: dict[str, Any]) -> Any:
    """The encoder that a checkpoint notes, first without memory: the note may come from anybody."""
    from transformers import AutoConfig

    try:
        layers = [value for key, value in noted.items() if "layers" in key and isinstance(value, int)]
        if max(layers, default=0) > 200:
            raise ValueError("it has more than 200 layers")
        config = AutoConfig.for_model(**noted)
        with torch.device("meta"):
            _check_size(_text_encoder(lambda factory: factory.from_config(config, trust_remote_code=False)))
        return _text_encoder(lambda factory: factory.from_config(config, trust_remote_code=False))
    except Exception as error:  # every library says it in its own way
        reason = " ".join(str(error).split())
        raise UserError(f"config.json: language_model describes no encoder: {reason:.200}") from error


def _text_encoder(make: Callable[[Any], Any]) -> Any:
    """Of a model that does more, such as T5, the part that encodes text."""
    from transformers import AutoModel, AutoModelForTextEncoding  # slow to import, and word-level policies do without

    try:
        return make(AutoModelForTextEncoding)
    except ValueError:  # no such part
        return make(AutoModel)


def _check_size(model: nn.Module) -> None:
    size = sum(parameter.numel() for parameter in model.parameters())
    if size > MOST_PARAMETERS:
        raise UserError(
            f"the language encoder has {size:.1e} parameters, {MOST_PARAMETERS:.0e} is the most: choose a smaller one"
        )


def _jsonable(settings: dict[str, Any]) -> dict[str, Any]:
    """Leave out what JSON cannot hold and what a rebuilt encoder does not need."""
    return {key: value for key, value in settings.items() if isinstance(value, str | int | float | bool | list)}
