"""The compiled tabletop and its physics: what docs/lorel_environment.md says of the model, resets and steps."""

import numpy as np
import pytest

from lerobot_lisa.envs.lorel.scene import ARMS, build_model, metaworld_assets
from lerobot_lisa.envs.lorel.simulator import LorelSimulator
from lerobot_lisa.envs.lorel.state import BLACK_X, DRAWER, FAUCET, WHITE_X, WHITE_Y
from lerobot_lisa.errors import UserError


def reset(seed: int, arm: str = "original") -> LorelSimulator:
    simulator = LorelSimulator(arm)
    simulator.reset(np.random.default_rng(seed))
    return simulator


def test_model() -> None:
    model = build_model()
    assert (model.nq, model.nv, model.nu, model.nmocap) == (15, 15, 2, 1)
    assert model.qpos0.tolist() == [0] * 15
    assert (model.geom_contype | model.geom_conaffinity != 0).sum() == 31
    assert model.body("white_mug").mass == model.body("black_mug").mass == pytest.approx(11)
    np.testing.assert_allclose(model.dof_damping, [10] * 7 + [1000] * 2 + [200] * 4 + [2, 20])
    np.testing.assert_allclose(model.dof_armature, [0.001] * 7 + [100] * 2 + [0] * 4 + [0.001] * 2)
    assert model.jnt_limited[9:13].tolist() == [0] * 4


def test_models_are_shared() -> None:
    assert build_model("original") is LorelSimulator().model
    assert build_model("free") is not LorelSimulator().model


def test_resets_lie_where_the_page_says() -> None:
    states = np.array([reset(seed).state for seed in range(40)])
    np.testing.assert_allclose(states[:, :7].mean(0), ARMS["original"].home, atol=0.2)
    assert ((states[:, [WHITE_X, BLACK_X]] > -0.35) & (states[:, [WHITE_X, BLACK_X]] < -0.05)).all()
    assert (np.abs(states[:, FAUCET]) < np.pi / 4 + 0.02).all()
    assert ((states[:, DRAWER] > -0.1) & (states[:, DRAWER] < 0.001)).all()
    assert len(np.unique(states[:, WHITE_Y].round(4))) == 40


def test_same_seed_same_trajectory() -> None:
    used, fresh = reset(5), LorelSimulator()
    used.step(np.ones(5))
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 5))
    traces = []
    for simulator in (used, fresh):
        simulator.reset(np.random.default_rng(7))
        traces.append(
            [simulator.state.tobytes(), *((simulator.step(a), simulator.state.tobytes())[1] for a in actions)]
        )
    assert traces[0] == traces[1]


def test_the_wrist_has_no_effect_and_actions_stay_as_they_were() -> None:
    one, other = reset(3), reset(3)
    action = np.array([0.3, -0.5, 0.2, 3.0, 1.0], np.float32)
    one.step(action)
    other.step([0.3, -0.5, 0.2, -3.0, 1.0])
    np.testing.assert_allclose(one.state, other.state, atol=1e-7)
    assert action[3] == 3.0


def test_the_target_moves_and_stops_at_the_edge() -> None:
    simulator = reset(0)
    for _ in range(5):
        simulator.step([9, -9, 0.5, 0, 0])
    np.testing.assert_allclose(simulator.data.mocap_pos[0], [0.3, 0.4, 0.15])


def test_a_step_takes_twelve_and_a_half_milliseconds() -> None:
    simulator = reset(0)
    before = simulator.data.time
    simulator.step(np.zeros(5))
    assert simulator.data.time - before == pytest.approx(0.0125)


@pytest.mark.parametrize("action", [np.zeros(4), np.zeros((1, 5)), [np.nan] * 5, [np.inf] * 5])
def test_refuses_what_is_no_action(action) -> None:
    with pytest.raises(ValueError, match="five finite numbers"):
        reset(0).step(action)


def test_only_the_free_arm_reaches_its_target() -> None:
    gaps = {}
    for arm in ARMS:
        simulator = LorelSimulator(arm)
        simulator.reset_for_task(np.random.default_rng(0), {}, (0, 0.45, 0.1))
        gaps[arm] = np.linalg.norm(simulator.hand - (0, 0.45, 0.1))
    assert gaps["free"] < 0.03 < 0.08 < gaps["original"]


def test_set_state_is_read_back() -> None:
    simulator, state = reset(0), reset(1).state
    simulator.set_state(state)
    np.testing.assert_array_equal(simulator.state, state)


def test_unknown_arm_and_missing_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match="no arm 'stiff'"):
        LorelSimulator("stiff")
    monkeypatch.setattr("lerobot_lisa.envs.lorel.scene.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install \"lerobot_policy_lisa\[lorel\]\""):
        metaworld_assets()
