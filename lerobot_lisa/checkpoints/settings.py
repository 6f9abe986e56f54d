"""A checkpoint's configuration, `config.json` with the user's overrides."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig, parser

from lerobot_lisa.checkpoints.files import CONFIG, RETAKE, Files, find, refusing
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.episode_settings import WORDS
from lerobot_lisa.policies.vision import PICTURES, of_torchvision

_LARGEST = 2**20  # of a language encoder's sizes; the greatest vocabularies have a quarter of that
_DEEPEST = 200  # layers


def load_config(name: str, overrides: Sequence[str] = ()) -> EpisodePolicyConfig:
    """The configuration of a checkpoint of ours, from a folder or the Hub.

    Args:
        name: Folder or Hub id.
        overrides: Options of the command line without `--policy.`, such as `--action_temperature=0`;
            `--pretrained_revision` chooses a revision of the Hub's repository.

    Returns:
        The configuration; its `pretrained_path` is `name`, its `pretrained_revision` the commit that was found.

    Raises:
        UserError: There is no checkpoint, it is another policy's, or its configuration cannot work.
    """
    files = find(name, parser.parse_arg("pretrained_revision", overrides))
    path, settings = files.path(CONFIG), files.json(CONFIG)
    _check_kind(files, settings)
    for key in ("input_features", "output_features"):
        if not settings.get(key):  # LeRobot would take the environment's
            raise UserError(f"{path} names no {key}: {RETAKE}")
    fix = "correct the --policy options" if overrides else RETAKE
    with refusing(f"{path} cannot be used", fix), _naming(path, overrides):
        config = PreTrainedConfig.from_pretrained(path.parent, cli_overrides=list(overrides))
        config.validate_features()
    config.language_model = _noted(files, "language_model", config.language_model, config.language_encoder != WORDS)
    noted = config.vision_backbone is not None and not of_torchvision(config.vision_backbone)
    config.vision_model = _noted(files, "vision_model", config.vision_model, noted, PICTURES)
    config.pretrained_backbone_weights = None  # would be fetched; the checkpoint has them
    config.pretrained_path, config.pretrained_revision = Path(name), files.revision
    return config


@contextmanager
def _naming(path: Path, overrides: Sequence[str]) -> Iterator[None]:
    """Name the file in a line about an option that nobody gave: it is a setting of the file."""
    given = {override.lstrip("-").split("=")[0] for override in overrides}
    try:
        yield
    except UserError as error:
        option = re.search(r"--policy\.(\w+)", str(error))
        if option and option[1] in given:
            raise
        raise UserError(f"{path}: {error}") from None


def _check_kind(files: Files, settings: Mapping[str, Any]) -> None:
    kind = settings.get("type")
    ours = [
        name for name, made in PreTrainedConfig.get_known_choices().items() if issubclass(made, EpisodePolicyConfig)
    ]
    if kind not in ours:
        raise UserError(
            f"--policy.path={files.name} is a {str(kind)[:100]} policy: "
            f"this reads checkpoints of {', '.join(sorted(ours))}"
        )
    if settings.get("use_peft"):
        raise UserError(f"{files.path(CONFIG)} is an adapter's (use_peft): merge it into the weights and save those")


def _noted(
    files: Files, field: str, noted: dict[str, Any] | None, needed: bool, others: Sequence[str] = ()
) -> dict[str, Any] | None:
    """The architecture of a pretrained encoder, without what would choose code or download something.

    Args:
        files: Of the checkpoint.
        field: Of its configuration, that holds the note.
        noted: The note.
        needed: Whether the policy has such an encoder.
        others: What the note holds besides.
    """
    path = files.path(CONFIG)
    if not noted:
        if needed:
            raise UserError(f"{path} does not describe its pretrained encoder ({field}): {RETAKE}")
        return None
    for key, value in noted.items():
        numbers = [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, int)]
        most = _DEEPEST if "layer" in key else _LARGEST
        if isinstance(value, dict) or any(not -most <= v <= most for v in numbers):
            raise UserError(f"{path}: {field}.{key} is {value!r:.100}, at most {most:,} can be built: {RETAKE}")
    from transformers import AutoConfig  # slow to import, and word-level policies do without

    with refusing(f"{path}: no encoder can be built from {field}"):
        if "timm" in str(noted["model_type"]):
            raise ValueError("timm models fetch their weights")
        known = AutoConfig.for_model(noted["model_type"]).to_dict()  # not in it: attn_implementation, auto_map, ...
    return {key: value for key, value in noted.items() if key in known or key in others}
