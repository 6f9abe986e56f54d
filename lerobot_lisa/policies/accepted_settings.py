"""Which values of settings are refused, in one line each, before anything is loaded or allocated."""

import torch

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.episode_settings import EpisodeSettings

DEVICES = ("cpu", "cuda", "mps", "xpu")
MOST_PARAMETERS = 500_000_000  # 2 GB; the paper's networks have a million. A config.json may come from anybody


def check_device(device: str | None) -> None:
    """Before LeRobot does, whose words draccus swallows."""
    try:
        known = not device or torch.device(device).type in DEVICES
    except RuntimeError:
        known = False
    if not known:
        raise UserError(f"--policy.device={short(device)} is not one of: {', '.join(DEVICES)}, cuda:0, cuda:1, ...")


def check_choice(config: EpisodeSettings, name: str, choices: tuple[str, ...]) -> None:
    """A setting that is one of few words."""
    if getattr(config, name) not in choices:
        raise UserError(f"--policy.{name}={short(getattr(config, name))} is not one of: {', '.join(choices)}")


def check_numbers(config: EpisodeSettings) -> None:
    """All within their bounds, and those that have to fit each other."""
    for name, (least, most) in config.BOUNDS.items():
        _check_number(name, getattr(config, name), least, most)
    for beta in config.optimizer_betas:
        _check_number("optimizer_betas", beta, 0, 0.999999)
    if config.dim_model % 2 or config.dim_model % config.n_heads:
        raise UserError(
            f"--policy.dim_model={config.dim_model} must be even and a multiple of --policy.n_heads={config.n_heads}: "
            "choose e.g. 128 and 4"
        )


def check_size(config: EpisodeSettings, parameters: int) -> None:
    """Of the whole policy."""
    if parameters > MOST_PARAMETERS:
        raise UserError(
            f"the policy would have about {parameters:.1e} parameters, {MOST_PARAMETERS:.0e} is the most: choose a "
            f"smaller --policy.dim_model than {config.dim_model}, or fewer layers, codes, bins, steps or features"
        )


def short(value: object) -> str:
    """A value in a message: nobody reads more of it."""
    text = str(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


def _check_number(name: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:  # NaN is neither
        raise UserError(f"--policy.{name}={short(value)} must be between {least:g} and {most:g}")
