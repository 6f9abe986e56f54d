"""An episode whose task changes is trained on in runs of one task, as a rollout begins anew with every instruction."""

from pathlib import Path

import pytest
import recordings
import tiny_policies


@pytest.fixture(scope="module")
def changing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of 8 frames, whose second halves are another task's."""
    tasks = ["push the cube"] * 3 + ["open the drawer"] * 5
    return recordings.record(tmp_path_factory.mktemp("changing") / "data", (8, 8), lambda _, step: tasks[step], ())


@pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
def test_a_frame_is_trained_on_with_those_of_its_own_task(kind: str, changing: Path) -> None:
    made = tiny_policies.training(kind, changing)
    assert made.policy.config.max_timesteps == 5
    batch = made.batch([1, 7, 10])
    assert batch["task"] == ["push the cube", "open the drawer", "push the cube"]
    frames, packing = made.policy.gather(batch)
    assert packing.lengths.tolist() == [3, 5, 3]
    stored = [[0, 0], [0, 1], [0, 2], *([0, step] for step in range(3, 8)), [1, 0], [1, 1], [1, 2]]
    assert frames["observation.state"].shape == (11, 2)
    expected = made.policy.episode_store.columns["observation.state"].tolist()
    assert [expected[8 * episode + step] for episode, step in stored] == stored
    loss, _ = made.policy.forward(batch)
    loss.backward()
