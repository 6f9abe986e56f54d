"""Build the tabletop's MuJoCo model from `tabletop.xml` and the meshes, textures and arm that metaworld installs."""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from string import Template
from types import MappingProxyType
from xml.sax.saxutils import escape

from lerobot_lisa.envs.engine import mujoco
from lerobot_lisa.envs.lorel.installation import INSTALL
from lerobot_lisa.envs.options import one_of
from lerobot_lisa.errors import UserError


@dataclass(frozen=True)
class Arm:
    """How the arm behaves.

    Attributes:
        torquescale: How strongly the hand keeps its direction, against how strongly it follows its target.
        home: The seven joints at the start of a reset, in radians.
    """

    torquescale: float
    home: tuple[float, float, float, float, float, float, float]


ARMS = MappingProxyType(
    {
        # The released environment on the engine of its time: locked in an elbow branch, joints 2 and 5 beyond their
        # limits, so that the hand stays some 10 cm above and behind its target.
        "original": Arm(12, (1.296, -0.484, -3.191, -0.132, 0.046, 4.219, -0.107)),
        # The hand reaches its target: an easier world, whose numbers compare with nobody's.
        "free": Arm(5, (1.8, -0.5, -1.1, 1.2, 0.92, 1.36, 2.5)),
    }
)


# Contacts as in the engine of the original: newer ones find them in other ways (3.3.0 made its own routine the default,
# later ones several contacts per pair of convex bodies too), after which objects move less like the original's.
_NEWER_COLLISIONS = sum(int(getattr(mujoco.mjtDisableBit, name, 0)) for name in ("mjDSBL_NATIVECCD", "mjDSBL_MULTICCD"))


def check_arm(name: str) -> str:
    """Return the name of an arm, or raise `UserError` if there is none of that name."""
    return one_of(ARMS, name, f"no arm {name!r}", " (only 'original' compares with the paper)")


@cache
def build_model(arm: str = "original") -> mujoco.MjModel:
    """Compile the tabletop; all simulators and cameras of a process share the result.

    Raises:
        UserError: If metaworld is not installed or there is no such arm.
    """
    behaviour = ARMS[check_arm(arm)]
    template = Template(Path(__file__).with_name("tabletop.xml").read_text(encoding="utf-8"))
    assets = escape(str(metaworld_assets()), {'"': "&quot;"})
    spec = mujoco.MjSpec.from_string(template.substitute(assets=assets, torquescale=behaviour.torquescale))
    _fit_arm(spec)
    model = spec.compile()
    model.opt.disableflags |= _NEWER_COLLISIONS
    return model


def metaworld_assets() -> Path:
    """Folder of metaworld's meshes, textures and arm; metaworld itself is not imported.

    Raises:
        UserError: If it is not there.
    """
    package = find_spec("metaworld")
    if package is None or package.origin is None:
        raise UserError(f"LOReL needs the meshes of metaworld: {INSTALL}")
    assets = Path(package.origin).parent / "assets"
    if not (assets / "objects" / "assets" / "xyz_base.xml").is_file():
        raise UserError(f"{assets}: no Sawyer arm in it: install metaworld 3 again, {INSTALL}")
    return assets


def engine() -> str:
    """Name and version of the simulator, such as "mujoco 3.16.0"."""
    return f"mujoco {version('mujoco')}"


def _fit_arm(spec: mujoco.MjSpec) -> None:
    """Put metaworld's arm where LOReL has it."""
    spec.body("base").pos = [0, -0.2, -0.3]
    spec.body("hand").pos = [0, 0, 0.05]
    for finger in ("rightpad_geom", "leftpad_geom"):
        spec.geom(finger).solimp[:3] = [0.9, 0.9, 0.01]
