"""The real `lerobot-rollout` with a robot that needs no hardware, and what a policy says to a robot's faults."""

import logging
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tiny_datasets
import torch
from scripted_robot import CAMERAS, JOINTS, ScriptedRobot
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
CAMERA = {"dtype": "image", "shape": (48, 64, 3), "names": ["height", "width", "channels"]}
ARM = {"dtype": "float32", "shape": (6,), "names": JOINTS}
SMALL_PICTURES = {"image_size": 32, "excerpt_steps": 6, "lookback_steps": 6}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras and the joints of the scripted robot."""
    cameras = {f"observation.images.{camera}": CAMERA for camera in CAMERAS}
    features = {"observation.state": ARM, **cameras, "action": ARM}
    return tiny_datasets.write(tmp_path_factory.mktemp("recording") / "data", features, lengths=[12, 20, 9])


@pytest.fixture
def handlers() -> Iterator[None]:
    """LeRobot's programs install handlers of their own, for signals and for the log."""
    names, root = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT), logging.getLogger()
    before, log, level = {name: signal.getsignal(name) for name in names}, root.handlers[:], root.level
    yield
    for name, handler in before.items():
        signal.signal(name, handler)
    root.handlers[:] = log
    root.setLevel(level)


def trained(kind: str, recording: Path) -> Training:
    return training(kind, recording, **SMALL_PICTURES).warm_up()


def lerobot_rollout(made: Training, folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    from lerobot.scripts.lerobot_rollout import main

    for part in (made.policy, made.preprocessor, made.postprocessor):
        part.save_pretrained(folder)
    always = [f"--policy.path={folder}", "--robot.type=scripted_robot", "--device=cpu", "--play_sounds=false"]
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", *always, "--return_to_initial_position=false", *arguments])
    main()


@BOTH
def test_lerobot_rollout(
    kind: str, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    made = trained(kind, recording)

    lerobot_rollout(made, tmp_path, monkeypatch, "--task=go to the red ball", "--duration=2")

    assert len(ScriptedRobot.sent) >= 5
    assert all(set(action) == set(JOINTS) for action in ScriptedRobot.sent)
    assert np.isfinite([list(action.values()) for action in ScriptedRobot.sent]).all()


def test_no_task_is_said_once(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    handlers: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`--task` defaults to nothing at all."""
    lerobot_rollout(trained("lisa", recording), tmp_path, monkeypatch, "--duration=1")

    assert capsys.readouterr().err.count("the instruction is blank: say what is to be done, such as with --task") == 1


def test_wider_pictures_than_the_recorded_ones_are_said_once(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    handlers: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    size = ["--robot.height=54", "--robot.width=96"]
    lerobot_rollout(trained("lang_dt", recording), tmp_path, monkeypatch, "--task=go", "--duration=1", *size)

    said = capsys.readouterr().err
    for camera in CAMERAS:
        assert said.count(f"`observation.images.{camera}` shows pictures of 54 x 96 pixels") == 1
    assert len(ScriptedRobot.sent) >= 2


def test_a_broken_sensor_moves_nothing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    made = trained("lisa", recording)

    with pytest.raises(UserError, match=r"`observation\.state` holds NaN or infinite numbers: look at the sensor"):
        lerobot_rollout(made, tmp_path, monkeypatch, "--task=go", "--duration=5", "--robot.broken_from=4")

    assert np.isfinite([list(action.values()) for action in ScriptedRobot.sent]).all()


@BOTH
def test_a_camera_that_is_missing_in_the_middle_is_one_line(kind: str, recording: Path) -> None:
    made = trained(kind, recording)
    shown = {
        "observation.state": torch.zeros(1, 6),
        **{f"observation.images.{camera}": torch.zeros(1, 3, 48, 64) for camera in CAMERAS},
    }
    made.policy.select_action(made.preprocessor({**shown, "task": ["go"]}))

    del shown["observation.images.wrist"]
    with pytest.raises(UserError, match=r"trained on observation\.images\.wrist, but the environment shows"):
        made.policy.select_action(made.preprocessor({**shown, "task": ["go"]}))


@BOTH
def test_another_number_of_robots_without_a_reset_starts_anew(kind: str, recording: Path) -> None:
    """A missed reset: the history would be of other robots."""
    made = trained(kind, recording)

    def act(robots: int) -> torch.Tensor:
        shown = {
            "observation.state": torch.zeros(robots, 6),
            **{f"observation.images.{camera}": torch.zeros(robots, 3, 48, 64) for camera in CAMERAS},
        }
        return made.policy.select_action(made.preprocessor({**shown, "task": ["go"] * robots}))

    act(2)
    assert act(3).shape == (3, 6)
