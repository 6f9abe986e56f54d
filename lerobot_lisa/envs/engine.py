"""MuJoCo, imported in the one place that first chooses how it will draw."""

import os

from lerobot_lisa.envs.gl import choose_gl, no_gl
from lerobot_lisa.errors import UserError

choose_gl()

try:
    import mujoco
except (RuntimeError, AttributeError) as error:  # of MuJoCo itself, or of PyOpenGL where its library is missing
    if not (setting := os.environ.get("MUJOCO_GL")):
        raise
    raise UserError(
        f"MUJOCO_GL is {setting}, which does not work here ({error}): unset it, or set it to egl, osmesa or glfw"
    ) from error


def check_drawing(what: str, states_only: str) -> None:
    """Raise `UserError` unless MuJoCo can draw here: worlds that are not ours fail with pages of traceback.

    Args:
        what: The world.
        states_only: The option that does without pictures.
    """
    try:
        if not hasattr(mujoco, "Renderer"):  # MuJoCo keeps to itself why it could not load one
            raise RuntimeError("MuJoCo cannot load it")
        mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16).close()
    except Exception as error:  # whatever OpenGL's bindings throw
        raise UserError(no_gl(error, what, states_only)) from error


__all__ = ["check_drawing", "mujoco"]
