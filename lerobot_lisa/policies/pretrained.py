"""Models of the Hub or a folder: fetched for a new policy, built without a download from what a checkpoint notes."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import nn

from lerobot_lisa.errors import UserError

MOST_PARAMETERS = 2_000_000_000
_DEEPEST = 200  # layers


class Half(NamedTuple):
    """A part of a model that may do more.

    Attributes:
        what: It is.
        settings: Field of the whole model's configuration that holds the part's.
        factories: Classes of `transformers` that may know it, the best one first.
    """

    what: str
    settings: str
    factories: tuple[str, ...]


TEXT = Half("encoder of text", "text_config", ("AutoModelForTextEncoding", "AutoModel"))
VISION = Half("encoder of pictures", "vision_config", ("AutoModel",))


def fetched(name: str, half: Half, missing: str) -> nn.Module:
    """A model with its weights.

    Args:
        name: Hub id or folder.
        half: Which part of the model.
        missing: What to say if it is not there.

    Raises:
        UserError: It is not there, has no such part, or is too large.
    """
    from transformers import AutoConfig

    try:
        whole = AutoConfig.from_pretrained(name, trust_remote_code=False)
        config = getattr(whole, half.settings, None) or whole
        model = _first(half, lambda made: made.from_pretrained(name, config=config, trust_remote_code=False))
    except OSError as error:
        raise UserError(missing) from error
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{name} holds no {half.what} that transformers knows ({reason:.200})") from error
    _check_size(model)
    for parameter in model.parameters():  # mapped from a file, at any address, products differ in the last digit
        parameter.data = parameter.data.clone()
    return model.float()  # whatever it was saved in


def rebuilt(noted: Mapping[str, Any], half: Half, field: str) -> nn.Module:
    """The model that a checkpoint notes, first without memory: the note may come from anybody.

    Args:
        noted: From `note`.
        half: Which part of the model.
        field: Of the configuration, that holds the note.

    Raises:
        UserError: There is no such model.
    """
    from transformers import AutoConfig

    try:
        layers = [value for key, value in noted.items() if "layers" in key and isinstance(value, int)]
        if max(layers, default=0) > _DEEPEST:
            raise ValueError(f"it has more than {_DEEPEST} layers")
        config = AutoConfig.for_model(**noted)
        with torch.device("meta"):
            _check_size(_first(half, lambda made: made.from_config(config, trust_remote_code=False)))
        return _first(half, lambda made: made.from_config(config, trust_remote_code=False)).float()
    except Exception as error:  # every library says it in its own way
        reason = " ".join(str(error).split())
        raise UserError(f"config.json: {field} describes no encoder: {reason:.200}") from error


def _first(half: Half, make: Callable[[Any], Any]) -> nn.Module:
    """Built by the first class that can."""
    import transformers  # slow to import, and policies of words and convolutions do without

    *others, last = (getattr(transformers, name) for name in half.factories)
    for factory in others:
        try:
            model: nn.Module = make(factory)
        except ValueError:  # no such part
            continue
        return model
    model = make(last)
    return model


def note(model: Any) -> dict[str, Any]:
    """Of a model's configuration, what JSON can hold and a rebuilt one needs."""
    settings: dict[str, Any] = model.config.to_dict()
    return {key: value for key, value in settings.items() if isinstance(value, str | int | float | bool | list)}


def _check_size(model: nn.Module) -> None:
    size = sum(parameter.numel() for parameter in model.parameters())
    if size > MOST_PARAMETERS:
        raise UserError(
            f"the pretrained encoder has {size:.1e} parameters, {MOST_PARAMETERS:.0e} is the most: choose a smaller one"
        )
