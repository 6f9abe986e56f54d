"""Choose how MuJoCo draws without a display, before it is asked to."""

import ctypes
import os
import sys

from lerobot_lisa.errors import UserError

_HELP = (
    "install EGL (apt-get install libegl1 libgl1-mesa-dri) or OSMesa (apt-get install libosmesa6), or use states only "
    "(--env.obs_type=state)"
)


def choose_gl() -> str:
    """Set `MUJOCO_GL`, if it is not set, to what works here: EGL (GPU or software), else OSMesa.

    Must come before the first import of mujoco. Does nothing off Linux, where MuJoCo finds its own way.

    Returns:
        The setting; empty if it is left to MuJoCo.
    """
    if not os.environ.get("MUJOCO_GL") and "mujoco" not in sys.modules and (backend := _find_backend()):
        os.environ["MUJOCO_GL"] = backend
    return os.environ.get("MUJOCO_GL", "")


def no_gl(error: BaseException) -> UserError:
    """What to say when no picture can be drawn."""
    setting = os.environ.get("MUJOCO_GL") or "not set"
    reason = " ".join(str(error).split()) or type(error).__name__
    late = not os.environ.get("MUJOCO_GL") and _find_backend()
    help_ = f"set MUJOCO_GL={late} before mujoco is imported" if late else _HELP
    return UserError(f"cannot draw the tabletop (MUJOCO_GL is {setting}: {reason}): {help_}")


def _find_backend() -> str:
    """What works here without a display; empty if nothing does, or where MuJoCo finds its own way."""
    if sys.platform != "linux":
        return ""
    return "egl" if _egl_works() else "osmesa" if _loads("libOSMesa.so.8", "libOSMesa.so") else ""


def _loads(*names: str) -> bool:
    return any(_library(name) is not None for name in names)


def _library(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


def _egl_works() -> bool:
    """Whether some EGL device can be opened, which is what MuJoCo will try."""
    egl = _library("libEGL.so.1")
    if egl is None:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    addresses = [egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")]
    if not all(addresses):
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(addresses[0])
    open_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(addresses[1])
    devices, count = (ctypes.c_void_p * 16)(), ctypes.c_int(0)
    if not query(16, devices, ctypes.byref(count)):
        return False
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    displays = [open_display(_PLATFORM_DEVICE, device, None) for device in devices[: count.value]]
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


_PLATFORM_DEVICE = 0x313F  # EGL_PLATFORM_DEVICE_EXT
