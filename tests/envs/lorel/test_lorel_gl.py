"""How pictures are drawn is chosen before MuJoCo is imported, whatever is imported first; a way that works is taken."""

import os
import subprocess
import sys

import drawing
import programs
import pytest

from lerobot_lisa.envs import gl

FIRST_IMPORTS = (
    "lerobot_lisa.envs.lorel.scene",
    "lerobot_lisa.envs.lorel.simulator",
    "lerobot_lisa.envs.lorel.camera",
    "lerobot_lisa.envs.lorel.env",
    "dataset_converters.lorel.random_play",
)
CHOICE = {"MUJOCO_GL", "PYOPENGL_PLATFORM"}  # MuJoCo sets the second one by the first


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {key: value for key, value in os.environ.items() if key not in CHOICE} | environment
    return programs.run("python", "-c", code, env=env)


@pytest.mark.slow
def test_whatever_is_imported_first() -> None:
    """One process for each would import LeRobot five times: forks of one that has not imported MuJoCo do."""
    drawing.needs_gl()
    code = f"""
import importlib, os, sys
import lerobot_lisa
assert "mujoco" not in sys.modules and "MUJOCO_GL" not in os.environ
for name in {FIRST_IMPORTS}:
    if os.fork() == 0:
        importlib.import_module(name)
        from lerobot_lisa.envs.lorel.camera import Camera
        with Camera(size=16) as camera:
            drawn = camera.frame([0.0] * 15).max() > 0
        print(name, os.environ["MUJOCO_GL"], drawn, flush=True)
        os._exit(0)
    os.wait()
"""
    done = run(code)
    assert [line.split() for line in done.stdout.splitlines()] == [
        [name, gl._find_backend(), "True"] for name in FIRST_IMPORTS
    ], done.stderr


@pytest.mark.parametrize(
    ("egl", "osmesa", "chosen"),
    [(True, True, "egl"), (True, False, "egl"), (False, True, "osmesa"), (False, False, "")],
)
def test_egl_then_osmesa_then_nothing(monkeypatch: pytest.MonkeyPatch, egl: bool, osmesa: bool, chosen: str) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    there = {"libEGL.so.1": egl, "libOSMesa.so.8": osmesa}
    monkeypatch.setattr(gl, "_loads", lambda library: there[library])
    assert gl.choose_gl() == os.environ.get("MUJOCO_GL", "") == chosen


def test_a_choice_that_was_made_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    assert gl.choose_gl() == "glfw"


def test_libraries_that_are_not_there_are_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(gl.ctypes, "CDLL", missing)
    assert not gl._loads("libEGL.so.1")
    assert gl._find_backend() == ""


def test_what_to_do_when_nothing_can_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_find_backend", lambda: "")
    said = ("the tabletop", "--env.obs_type=state")
    nothing = gl.no_gl(RuntimeError("no\ndisplay"), *said)
    assert nothing.startswith("cannot draw the tabletop (MUJOCO_GL is not set: no display): install EGL (apt-get")
    assert "OSMesa (apt-get install libosmesa6)" in nothing
    assert nothing.endswith("or use states only (--env.obs_type=state)")
    monkeypatch.setattr(gl, "_find_backend", lambda: "egl")
    assert gl.no_gl(RuntimeError("late"), *said).endswith("late): set MUJOCO_GL=egl before mujoco is imported")


@pytest.mark.slow
@pytest.mark.skipif(not gl._loads("libOSMesa.so.8"), reason="OSMesa is not installed")
def test_osmesa_draws() -> None:
    code = """
from lerobot_lisa.envs.lorel.camera import Camera
with Camera(size=16) as camera:
    print(camera.frame([0.0] * 15).max() > 0)
"""
    done = run(code, MUJOCO_GL="osmesa")
    assert done.stdout == "True\n", done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [
        {"MUJOCO_GL": "disable"},
        {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "egl"},  # MuJoCo hides this failure
        {"MUJOCO_GL": "glfw", "DISPLAY": "", "WAYLAND_DISPLAY": ""},  # MuJoCo aborts at the second context
    ],
    ids=["disabled", "failing", "without a display"],
)
def test_no_gl_is_explained_and_states_do_without(environment: dict[str, str]) -> None:
    code = """
from lerobot_lisa.envs.lorel.env import LorelEnv
env = LorelEnv(obs_type="state", render_size=32)
env.reset(seed=0)
assert env.render().max() == 0
assert env.render().max() == 0
other = LorelEnv("open drawer", render_size=48)
other.reset(seed=0)
assert other.render().max() == 0
LorelEnv(obs_type="pixels").reset(seed=0)
"""
    done = run(code, **environment)
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr.count("Videos are black") == 1
    last = done.stderr.strip().splitlines()[-1]
    assert f"cannot draw the tabletop (MUJOCO_GL is {environment['MUJOCO_GL']}" in last
    assert "apt-get install libegl1 libgl1-mesa-dri" in last


@pytest.mark.slow
def test_a_setting_that_mujoco_does_not_know_is_one_line() -> None:
    done = run("import lerobot_lisa, lerobot_lisa.envs.lorel.scene", MUJOCO_GL="vulkan")
    assert done.stderr.splitlines()[-1] == (
        "error: MUJOCO_GL is vulkan, which does not work here (invalid value for environment variable MUJOCO_GL: "
        "vulkan): unset it, or set it to egl, osmesa or glfw"
    )
    assert "Traceback" not in done.stderr
