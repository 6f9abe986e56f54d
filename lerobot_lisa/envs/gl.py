"""How MuJoCo will draw, chosen before it is imported (`engine`): afterwards it is too late.

Left alone, MuJoCo draws into a window, which needs a display. Ways of drawing cannot be tried one after another:
PyOpenGL keeps the first one that a process names, and MuJoCo ends a process at the second context that does not open.
So the one is taken whose library is there, as dm_control does.
"""

import ctypes
import os
import sys

_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
_HELP = (
    "install EGL (apt-get install libegl1 libgl1-mesa-dri), or OSMesa (apt-get install libosmesa6) and set "
    "MUJOCO_GL=osmesa, or use states only"
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


def no_gl(error: BaseException, what: str, states_only: str) -> str:
    """What to say when no picture can be drawn.

    Args:
        error: Why.
        what: The world.
        states_only: The option that does without pictures.
    """
    setting = os.environ.get("MUJOCO_GL") or "not set"
    reason = " ".join(str(error).split()) or type(error).__name__
    late = not os.environ.get("MUJOCO_GL") and _find_backend()
    help_ = f"set MUJOCO_GL={late} before mujoco is imported" if late else f"{_HELP} ({states_only})"
    return f"cannot draw {what} (MUJOCO_GL is {setting}: {reason}): {help_}"


def _find_backend() -> str:
    """What is installed here that needs no display; empty if nothing is, or where MuJoCo finds its own way."""
    found = (name for name, library in _LIBRARIES.items() if sys.platform == "linux" and _loads(library))
    return next(found, "")


def _loads(library: str) -> bool:
    try:
        return bool(ctypes.CDLL(library))
    except OSError:
        return False
