"""MuJoCo, imported in the one place that first chooses how it will draw: afterwards it is too late.

Left alone, MuJoCo draws into a window, which needs a display. Ways of drawing cannot be tried one after another:
PyOpenGL keeps the first one that a process names, and MuJoCo ends a process at the second context that does not open.
So the one is taken whose library is there, as dm_control does.
"""

import ctypes
import os
import sys

from lerobot_lisa.errors import UserError

_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
_HELP = (
    "install EGL (apt-get install libegl1 libgl1-mesa-dri), or OSMesa (apt-get install libosmesa6) and set "
    "MUJOCO_GL=osmesa, or use states only (--env.obs_type=state)"
)


def choose_gl() -> str:
    """Set `MUJOCO_GL`, if it is not set, to what is installed here: EGL (GPU or software), else OSMesa.

    Does nothing off Linux, where MuJoCo finds its own way, nor after the first import of mujoco.

    Returns:
        The setting; empty if it is left to MuJoCo.
    """
    if not os.environ.get("MUJOCO_GL") and "mujoco" not in sys.modules and (backend := _find_backend()):
        os.environ["MUJOCO_GL"] = backend
    return os.environ.get("MUJOCO_GL", "")


def no_gl(error: BaseException) -> str:
    """What to say when no picture can be drawn."""
    setting = os.environ.get("MUJOCO_GL") or "not set"
    reason = " ".join(str(error).split()) or type(error).__name__
    late = not os.environ.get("MUJOCO_GL") and _find_backend()
    help_ = f"set MUJOCO_GL={late} before mujoco is imported" if late else _HELP
    return f"cannot draw the tabletop (MUJOCO_GL is {setting}: {reason}): {help_}"


def _find_backend() -> str:
    """What is installed here that needs no display; empty if nothing is, or where MuJoCo finds its own way."""
    found = (name for name, library in _LIBRARIES.items() if sys.platform == "linux" and _loads(library))
    return next(found, "")


def _loads(library: str) -> bool:
    try:
        return bool(ctypes.CDLL(library))
    except OSError:
        return False


choose_gl()

try:
    import mujoco
except (RuntimeError, AttributeError) as error:  # of MuJoCo itself, or of PyOpenGL where its library is missing
    if not (setting := os.environ.get("MUJOCO_GL")):
        raise
    raise UserError(
        f"MUJOCO_GL is {setting}, which does not work here ({error}): unset it, or set it to egl, osmesa or glfw"
    ) from error

__all__ = ["choose_gl", "mujoco", "no_gl"]
