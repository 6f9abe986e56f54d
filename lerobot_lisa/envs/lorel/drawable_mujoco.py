"""MuJoCo, imported in the one place that first chooses how it will draw: afterwards it is too late."""

import os

from lerobot_lisa.envs.lorel.gl import choose_gl
from lerobot_lisa.errors import UserError

choose_gl()

try:
    import mujoco
except RuntimeError as error:
    if "MUJOCO_GL" not in str(error):
        raise
    raise UserError(f"MUJOCO_GL is {os.environ['MUJOCO_GL']}: unset it, or set it to egl, osmesa or glfw") from error

__all__ = ["mujoco"]
