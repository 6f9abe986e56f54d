"""Tell what the tabletop needs before anything of it is imported."""

from importlib.util import find_spec

from lerobot_lisa.errors import UserError

INSTALL = 'pip install "lerobot_policy_lisa[lorel]"'


def check_installed() -> None:
    """Raise `UserError` unless MuJoCo and metaworld, whose files make the scene, are there."""
    for package in ("mujoco", "metaworld"):
        if not _is_there(package):
            raise UserError(f"LOReL needs {package}: {INSTALL}")


def _is_there(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except ValueError:  # imported, but without a specification
        return False
