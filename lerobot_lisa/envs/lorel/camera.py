"""Pictures of the tabletop, for data and evaluation alike.

    with Camera() as camera:
        image = camera.frame(state)  # uint8 (64, 64, 3)

The same state gives the same picture whenever it is drawn, so that data can be rendered long after they were made.
"""

import atexit
from dataclasses import dataclass
from functools import cache
from threading import get_ident
from types import MappingProxyType, TracebackType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lerobot_lisa.envs.engine import mujoco
from lerobot_lisa.envs.gl import no_gl
from lerobot_lisa.envs.lorel.scene import build_model
from lerobot_lisa.envs.options import one_of, whole_number
from lerobot_lisa.errors import UserError


@dataclass(frozen=True)
class Quality:
    """What is drawn; without a GPU, reflections and shadows cost far more than all the rest.

    Attributes:
        shadow: Whether the one light that can cast shadows does.
        reflection: Whether the floor and the paint reflect.
        samples: Samples per pixel, against jagged edges; 0 for none.
    """

    shadow: bool
    reflection: bool
    samples: int


QUALITIES = MappingProxyType(
    {
        "minimal": Quality(shadow=False, reflection=False, samples=0),
        "smooth": Quality(shadow=False, reflection=False, samples=4),
        "full": Quality(shadow=True, reflection=True, samples=4),  # the original's
    }
)

IMAGE_SIZE = 64
"""Pixels along each side of the pictures in data and observations."""


def check_quality(name: str) -> str:
    """Return the name of an image quality, or raise `UserError` if there is none of that name."""
    return one_of(QUALITIES, name, f"no image quality {name!r}", ", the one of the training data")


def check_size(size: int) -> int:
    """Return the pixels along each side of an image, or raise `UserError` if there are too few or too many."""
    return whole_number(size, 16, 480, f"an image of {size} x {size} pixels")


class Camera:
    """The camera `cam0`; the first frame opens an OpenGL context, `close` gives it back.

    A context belongs to the thread that opened it. A process that could not open one opens no other: MuJoCo would end
    it at the second try.
    """

    _why_none_opens: ClassVar[str] = ""

    def __init__(self, quality: str = "minimal", size: int = IMAGE_SIZE, arm: str = "original") -> None:
        """Prepare to draw.

        Args:
            quality: `minimal`, `smooth` or `full`.
            size: Pixels along each side, 16 to 480.
            arm: Only to share the model with a simulator; all arms look the same.

        Raises:
            UserError: If an argument is out of range.
        """
        self._quality, self._size = QUALITIES[check_quality(quality)], check_size(size)
        self._model = build_model(arm)
        self._data = mujoco.MjData(self._model)
        self._renderer: Any = None
        self._thread = 0

    def frame(self, state: ArrayLike) -> np.ndarray:
        """Draw a state.

        Args:
            state: The 15 joint positions; taken as float32, as data sets store them.

        Returns:
            uint8 (size, size, 3).

        Raises:
            UserError: If this machine cannot draw, or another thread has drawn with this camera.
        """
        if self._renderer is None:
            self._renderer, self._thread = self._open(), get_ident()
        if self._thread != get_ident():
            raise UserError("a LOReL camera draws in one thread, and another one has used it: use a process for each")
        self._data.qpos[:] = np.asarray(state, np.float32)
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, "cam0")
        return self._renderer.render()

    def close(self) -> None:
        """Give the OpenGL context back; the next frame would open a new one."""
        if self._renderer is not None:
            atexit.unregister(self._renderer.close)
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open(self) -> Any:
        if Camera._why_none_opens:
            raise UserError(Camera._why_none_opens)
        # Read once, when the context is made, and put back: cameras of other qualities and the simulators share the
        # model, and a collection tells scenes apart by its bytes.
        quality = self._model.vis.quality
        samples, quality.offsamples = quality.offsamples, self._quality.samples
        try:
            if not hasattr(mujoco, "Renderer"):  # MuJoCo keeps to itself why it could not load one
                raise RuntimeError("MuJoCo cannot load it")
            renderer = mujoco.Renderer(self._model, self._size, self._size)
        except Exception as error:  # whatever OpenGL's bindings throw
            Camera._why_none_opens = no_gl(error, "the tabletop", "--env.obs_type=state")
            raise UserError(Camera._why_none_opens) from error
        finally:
            quality.offsamples = samples
        atexit.register(renderer.close)  # only now: contexts must go before what MuJoCo registers with the first one
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._quality.shadow
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = self._quality.reflection
        return renderer


@cache
def shared_camera(quality: str, size: int, arm: str) -> Camera:
    """The camera that all environments of this process draw with: a picture depends on nothing but the state.

    Opening an OpenGL context takes seconds without a GPU. It is given back when the process ends.
    """
    return Camera(quality, size, arm)
