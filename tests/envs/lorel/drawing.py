"""Whether this machine can draw the tabletop."""

from functools import cache

import pytest

from lerobot_lisa.envs.lorel.camera import shared_camera
from lerobot_lisa.errors import UserError


@cache
def _reason() -> str:
    try:
        shared_camera("minimal", 64, "original").frame([0.0] * 15)
    except UserError as error:
        return str(error)
    return ""


def needs_gl() -> None:
    """Skip the test that calls this where nothing can be drawn."""
    if _reason():
        pytest.skip(_reason())
