"""Where skills look: sums of what a policy says of itself, exact after interruptions, and told in figures and words."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny_checkpoints
import torch
from lerobot.configs import FeatureType, PolicyFeature
from minigrid.core.constants import IDX_TO_COLOR, IDX_TO_OBJECT
from report_pages import synthetic
from scripted_policies import Deaf, loading
from torch import Tensor

from lerobot_lisa.analysis.drawing import shorten, styled
from lerobot_lisa.analysis.material import Material
from lerobot_lisa.analysis.recording import record as record_module
from lerobot_lisa.analysis.recording import traces
from lerobot_lisa.analysis.recording.environment import Batch, Looks, Moment
from lerobot_lisa.analysis.recording.evaluation import EvaluationConfig, load_config
from lerobot_lisa.analysis.recording.looks import LOOKS_FILE, Look, LooksCollector, read
from lerobot_lisa.analysis.recording.record import record
from lerobot_lisa.analysis.skills import looking
from lerobot_lisa.analysis.training_data import TrainingData
from lerobot_lisa.envs.babyai.config import BabyAIEnvConfig
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.lisa.configuration_lisa import LisaConfig
from lerobot_lisa.policies.parts import thing_names

GRID, DIRECTION = "observation.grid", "observation.direction"
THINGS = [number for number, name in IDX_TO_OBJECT.items() if name in ("ball", "box", "key")]


@pytest.fixture(scope="module")
def naming(symbolic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a LISA checkpoint with two skill codes."""
    return tiny_checkpoints.lisa(symbolic, tmp_path_factory.mktemp("naming"), codebook_size=2)


def config(policy: Path, **changes: Any) -> EvaluationConfig:
    """Five short episodes of GoToLocal in three batches."""
    env = BabyAIEnvConfig(task="GoToLocal", max_episode_steps=9)
    settings = {"n_episodes": 5, "batch_size": 2, **changes}
    return EvaluationConfig(env=env, policy=load_config(str(policy)), **settings)


class Staring(Deaf):
    """Wanders, and looks: under skill 0 with half of its attention at the first thing in the stored grid, if any, and
    under skill 1 at its heading alone; which it follows goes by the step."""

    def select_action(self, batch: dict[str, Any], **more: Any) -> Tensor:
        cells = batch[GRID].reshape(-1, 49, 3).long()
        there = torch.isin(cells[..., 0], torch.tensor(THINGS))
        self.skill_codes = torch.full((len(cells),), self._step // 3 % 2)
        first = there & (there.cumsum(1) == 1) & (self.skill_codes == 0)[:, None]
        self.looks = {GRID: first * 0.5, DIRECTION: (self.skill_codes == 1)[:, None] * 0.25}
        self.questions = torch.full((len(cells),), 2)
        worlds = zip(cells, first, strict=True)
        names = [[_name(*cell) for cell, is_it in zip(*world, strict=True) if is_it] for world in worlds]
        self.seen = [*getattr(self, "seen", []), (self._rollout, self._step, names, first)]
        return super().select_action(batch, **more)


def _name(kind: Tensor, color: Tensor, _state: Tensor) -> str:
    return f"{IDX_TO_COLOR[int(color)]} {IDX_TO_OBJECT[int(kind)]}"


@pytest.fixture(scope="module")
def stared(naming: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Staring]:
    """Folder of a recording, and the policy that was recorded."""
    folder, made = tmp_path_factory.mktemp("stared"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(record_module, "load", loading(Staring, made))
        settings = config(naming)
        record(settings, folder / "trace", [LooksCollector(folder / "trace", settings.policy)])
    return folder / "trace", made[0]


def test_the_sums_are_what_a_policy_looked_at(stared: tuple[Path, Staring]) -> None:
    folder, policy = stared
    steps, looks = traces.read(folder).steps, {(look.code, look.feature): look for look in read(folder)}
    counted = {(row.episode, row.step) for row in steps.itertuples()}
    attention, named = np.zeros((7, 7)), {}
    for rollout, step, names, first in policy.seen:
        for index, of_one in enumerate(names):
            if (2 * rollout + index, step) in counted:
                attention += 0.5 * first[index].numpy().reshape(7, 7).T  # stored column by column
                for name in of_one:
                    named[name] = named.get(name, 0) + 0.5

    assert attention.sum() > 1
    assert looks[0, GRID].attention.tolist() == attention.tolist()
    assert {name: value for name, value in looks[0, GRID].named.items() if value} == named
    assert looks[1, GRID].attention.sum() == 0
    times = steps["code"].value_counts()
    for (code, _), look in looks.items():
        assert (look.steps, look.questions) == (times[code], 2 * times[code])
    assert looks[1, DIRECTION].named == {"direction": 0.25 * times[1]}


def test_a_skill_says_where_it_looks(stared: tuple[Path, Staring]) -> None:
    folder, _ = stared
    found = {looker.label: looker for looker in looking.lookers(read(folder), ["0 ball", "1 go"], "")}
    paid = found["0 ball"].paid
    assert 0 < paid <= 0.25
    assert found["0 ball"].in_words().startswith(f"pays {100 * paid:.0f} % of its attention to something; of that: ")
    assert found["1 go"].in_words() == "pays 12 % of its attention to something; of that: direction 100 %"
    name, share = next(iter(found["0 ball"].named.items()))
    assert found["0 ball"].in_view[name] >= share


def sums(folder: Path) -> bytes:
    return (folder / LOOKS_FILE).read_bytes()


@pytest.mark.parametrize("moment", ["in a batch", "between looks and steps"])
def test_an_interrupted_recording_goes_on_to_the_same_sums(
    moment: str, lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = config(lisa)

    def collect(folder: Path) -> None:
        record(settings, folder, [LooksCollector(folder, settings.policy)])

    collect(tmp_path / "whole")
    run, calls = record_module.run_batch, 0

    def stop_once(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 2 and moment == "in a batch":
            raise KeyboardInterrupt
        result = run(*arguments)
        if calls == 2:
            raise KeyboardInterrupt
        return result

    monkeypatch.setattr(record_module, "run_batch", stop_once)
    with pytest.raises(KeyboardInterrupt):
        collect(tmp_path / "stopped")
    collect(tmp_path / "stopped")
    assert calls == 1 + 3
    assert sums(tmp_path / "stopped") == sums(tmp_path / "whole")
    assert sum(look.steps for look in read(tmp_path / "whole") if look.feature == GRID) == len(
        traces.read(tmp_path / "whole").steps
    )


def test_each_question_looks_once(lisa: Path, lang_dt: Path, tmp_path: Path) -> None:
    """What is paid is at most all there is: a code's one part, or the words said that name things."""
    for policy in (lisa, lang_dt):
        settings, folder = config(policy), tmp_path / policy.name
        trace = record(settings, folder, [LooksCollector(folder, settings.policy)])
        looks = [look for look in read(folder) if look.feature == GRID]
        words, names = trace.steps["instruction"].astype(str).str.findall(r"\w+"), thing_names(settings.policy)
        expected = len(trace.steps) if policy == lisa else sum(word in names for said in words for word in said)
        assert sum(look.questions for look in looks) == expected
        assert all(0 <= looker.paid <= 1 for looker in looking.lookers(read(folder), list("01234"), ""))
        assert [look.code for look in looks] == (sorted(trace.steps["code"].unique()) if policy == lisa else [None])


def picture_moments(folder: Path, codes: list[int]) -> list[Look]:
    """A camera of two worlds for two steps, looked at in the first of 16 patches; each picture is of one grey."""
    policy = LisaConfig(**tiny_checkpoints.SMALL)
    key = "observation.images.front"
    policy.input_features = {key: PolicyFeature(FeatureType.VISUAL, (3, 8, 6))}
    collector = LooksCollector(folder, policy)
    attention = np.zeros((2, 16), np.float32)
    attention[:, 0] = 0.5
    for step in range(2):
        pictures = np.full((2, 8, 6, 3), 50 * step, np.uint8)
        pictures[1] += 10
        seen = {"observation": {"pixels": {"front": pictures}}, "looks": Looks({key: attention}, np.ones(2, np.int64))}
        collector.before_step(Moment(None, Batch("w", 0, 0), step, [0, 1], np.array(codes), ["", ""], **seen))
    collector.after_rollout(Moment(None, Batch("w", 0, 0), 2, [], None, ["", ""]))
    return read(folder)


def test_pictures_are_looked_at_patch_by_patch(tmp_path: Path) -> None:
    looks = picture_moments(tmp_path, [3, 4])
    assert [(look.code, look.steps, look.attention.shape) for look in looks] == [(3, 2, (4, 4)), (4, 2, (4, 4))]
    assert looks[0].attention[0, 0] == 1
    assert looks[0].named == {"images.front": 1}
    assert {int(look.picture.max()) - 10 * (look.code - 3) for look in looks} <= {0, 50}  # each its own world's
    with styled():
        drawn = looking.where(looking.lookers(looks, list("01234"), ""), looks[0].feature, "n = 1", from_above=False)
    assert [len(axes.images) for axes in drawn.figure.axes[:2]] == [2, 2]  # a picture and a veil of patches
    assert len(drawn.table) == 2 * 16
    assert "one picture that was seen" in drawn.reading


def test_sums_that_are_none(tmp_path: Path) -> None:
    assert read(tmp_path) == []
    (tmp_path / LOOKS_FILE).write_text("no table")
    with pytest.raises(UserError, match=r"looks\.parquet: not looks of lerobot_lisa"):
        read(tmp_path)


def test_figures_show_the_most_frequent_and_say_what_they_lack() -> None:
    steps = {code: 100 - code for code in range(80)}
    looks = [
        Look(code, GRID, times, times, np.full((7, 7), times / 98), {f"thing {code}": times / 2}, {f"thing {code}": 9})
        for code, times in steps.items()
    ]
    material = Material(synthetic(80, 6, episodes=9), TrainingData(None, None, ""), looks=looks)
    with styled():
        by_name, where = looking.answer(material).plots
    assert [label.get_text() for label in by_name.figure.axes[0].get_yticklabels()] == [str(code) for code in range(60)]
    assert "Left out: 20 rarer skills and 40 rarer names; the CSV has all." in by_name.reading
    assert "44 rarer skills are left out" in where.reading
    assert where.table["skill_code"].nunique() == 80
    table = by_name.table.set_index(["skill_code", "name"])
    numbers = table.loc[("7", "thing 7"), ["attention", "in_view", "attention_paid"]]
    assert numbers.tolist() == pytest.approx([0.5, 9 / 93, 0.5])


def test_parts_of_long_names_stay() -> None:
    assert shorten("3 red ball") == "3 red ball"
    assert shorten("817 pick up the grey / the red ball / then go", 24) == "817 p… / the r… / then …"
    assert shorten("x" * 50) == "x" * 39 + "…"
