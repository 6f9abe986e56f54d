"""Words by skill: counts on hand-made episodes, and the real command on a real checkpoint."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from tiny_checkpoints import CODES, HORIZON
from torch.utils.data import default_collate

from lerobot_lisa.analysis.figures.skill_words import draw
from lerobot_lisa.analysis.skill_words import load, main, use_skills
from lerobot_lisa.analysis.statistics.words import count_words, normalise, top_words
from lerobot_lisa.errors import UserError


def test_each_code_of_an_episode_gets_all_words() -> None:
    words, counts = count_words(["Go to the ball, then go", "open"], [[2, 0, 2], [0]], 4)
    assert words == ["ball", "go", "open", "the", "then", "to"]
    assert counts[:, 0].tolist() == [1, 2, 1, 1, 1, 1]
    assert counts[:, 2].tolist() == [1, 2, 0, 1, 1, 1]
    assert not counts[:, [1, 3]].any()


@given(st.lists(st.tuples(st.sampled_from(["go", "go to", "a b c"]), st.lists(st.integers(0, 3), min_size=1))))
def test_shares_sum_to_one_or_nothing(episodes: list[tuple[str, list[int]]]) -> None:
    _, counts = count_words([text for text, _ in episodes], [codes for _, codes in episodes], 4)
    for axis in (0, 1):
        sums = normalise(counts, axis).sum(axis)
        assert np.isclose(sums, counts.sum(axis) > 0).all()


def test_top_words_set_a_skill_apart() -> None:
    episodes = [("go to the red ball", [0]), ("go to the red key", [0]), ("go to the blue key", [1])] * 5
    words, counts = count_words([text for text, _ in episodes], [codes for _, codes in episodes], 3)
    first, second, unused = top_words(words, counts, most=2)
    # "red" is a fifth of skill 0's words and two fifteenths of all.
    assert first[0] == ("red", pytest.approx(1.5))
    assert second == [("blue", pytest.approx(3.0)), ("key", pytest.approx(1.5))]
    assert unused == []


def test_the_codes_are_those_of_a_rollout(lisa: Path, symbolic: Path) -> None:
    dataset = LeRobotDataset("local/tiny", root=symbolic)
    policy, preprocess = load(str(lisa), dataset)
    use = use_skills(policy, preprocess, dataset, batch_size=4)

    lengths = list(dataset.meta.episodes["length"])
    assert [len(codes) for codes in use.codes] == [-(-length // HORIZON) for length in lengths]
    assert use.instructions == [tasks[0] for tasks in dataset.meta.episodes["tasks"]]
    for episode in (0, 4):
        policy.reset()
        start = dataset.meta.episodes["dataset_from_index"][episode]
        seen = []
        for frame in range(start, start + lengths[episode]):
            batch = default_collate([dataset[frame]])
            observed = {key: batch[key].reshape(1, *ft.shape) for key, ft in policy.config.input_features.items()}
            policy.select_action(preprocess({**observed, "task": batch["task"]}))
            seen.append(policy.skill_codes.item())
        assert seen[::HORIZON] == use.codes[episode]


def test_the_figure_is_the_same_each_time(tmp_path: Path) -> None:
    counts = np.random.default_rng(0).integers(0, 9, (18, 20))
    words = [f"word{i}" for i in range(18)]
    for name in ("a.png", "b.png"):
        draw(words, counts, "local/tiny: 6 episodes", tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_checkpoints_and_data_that_do_not_fit_are_refused(
    lisa: Path, lang_dt: Path, continuous_skills: Path, symbolic: Path, continuous: Path, tmp_path: Path
) -> None:
    dataset = LeRobotDataset("local/tiny", root=symbolic)
    with pytest.raises(UserError, match="is a lang_dt policy: only lisa has skill codes"):
        load(str(lang_dt), dataset)
    with pytest.raises(UserError, match="has continuous skills: there are no skill codes"):
        load(str(continuous_skills), dataset)
    with pytest.raises(UserError, match="no checkpoint"):
        load(str(tmp_path / "absent"), dataset)
    with pytest.raises(UserError, match=r"reads `observation\.grid` \(147,\): .* lacks it"):
        load(str(lisa), LeRobotDataset("local/tiny", root=continuous))


def arguments(policy: Path, root: Path, output: Path) -> list[str]:
    options = ["--policy-path", policy, "--dataset-root", root, "--repo-id", "local/tiny", "--output-dir", output]
    return [str(option) for option in options]


def test_command_line(lisa: Path, symbolic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(lisa, symbolic, tmp_path / "out")) == 0
    *_, summary, picture = capsys.readouterr().out.splitlines()
    assert picture == str(tmp_path / "out" / "skill_words.png")
    assert f"of {CODES} codes used, perplexity" in summary
    rows = list(csv.reader((tmp_path / "out" / "skill_words.csv").open()))
    assert rows[0] == ["word", *map(str, range(CODES))]
    assert "ball" in [row[0] for row in rows]


def test_what_is_wrong_is_said_in_one_line(lisa: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(lisa, tmp_path / "absent", tmp_path / "out")) == 1
    assert (
        capsys.readouterr().err
        == f"error: --dataset-root {tmp_path / 'absent'}: no LeRobotDataset (meta/info.json) there\n"
    )
    assert not (tmp_path / "out").exists()
