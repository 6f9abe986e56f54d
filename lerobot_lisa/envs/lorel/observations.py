"""What a policy is shown of the tabletop."""

from lerobot_lisa.envs.options import one_of

OBS_TYPES = ("state", "pixels", "pixels_state")


def check_obs_type(name: str) -> str:
    """Return the name of an observation type, or raise `UserError` if there is none of that name."""
    return one_of(OBS_TYPES, name, f"env.obs_type is {name!r}")


def shows_state(obs_type: str) -> bool:
    """Whether the 15 numbers of the state are part of it."""
    return obs_type != "pixels"


def shows_pixels(obs_type: str) -> bool:
    """Whether the camera's picture is part of it."""
    return obs_type != "state"
