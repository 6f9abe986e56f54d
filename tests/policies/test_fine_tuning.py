"""A policy goes on with another dataset: new words, longer episodes, other actions, cameras under other names."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
import tiny_datasets
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.processor import RenameObservationsProcessorStep
from tiny_policies import Training, training

from dataset_converters.writer import DatasetLayout, Episode, write_dataset
from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.errors import UserError

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
FEATURES = {"observation.state": tiny_datasets.STATE, "action": tiny_datasets.MOVE}


def other_dataset(root: Path, task: str = "push the cube", length: int = 40) -> Path:
    rng = np.random.default_rng(3)
    frames = {"observation.state": rng.normal(size=(length, 3)), "action": 100 + rng.normal(size=(length, 2))}
    frames = {key: value.astype(np.float32) for key, value in frames.items()}
    write_dataset(root, DatasetLayout("local/tiny", 10, FEATURES), [Episode(task, frames)])
    return root


class FineTuning(Training):
    """What `lerobot-train --policy.path=` makes of a checkpoint and a dataset."""

    def __init__(self, checkpoint: Path, root: Path) -> None:
        self.dataset = LeRobotDataset("local/tiny", root=root)
        cfg = PreTrainedConfig.from_pretrained(checkpoint)
        cfg.pretrained_path = checkpoint
        self.policy = make_policy(cfg, ds_meta=self.dataset.meta)
        stats = {"stats": self.dataset.meta.stats}
        self.preprocessor, self.postprocessor = make_pre_post_processors(
            cfg,
            pretrained_path=str(checkpoint),
            preprocessor_overrides={"normalizer_processor": stats},
            postprocessor_overrides={"unnormalizer_processor": stats},
        )


def save(made: Training, folder: Path) -> Path:
    for part in (made.policy, made.preprocessor, made.postprocessor):
        part.save_pretrained(folder)
    return folder


@BOTH
def test_another_dataset(kind: str, continuous: Path, tmp_path: Path) -> None:
    before = training(kind, continuous).warm_up()
    checkpoint = save(before, tmp_path / "before")

    after = FineTuning(checkpoint, other_dataset(tmp_path / "data")).warm_up()
    config, old = after.policy.config, before.policy.config

    assert config.vocabulary == [*old.vocabulary, "cube", "push"]
    assert set(config.lexicon) >= {*old.lexicon, "push", "the cube"}
    assert all(config.lexicon[phrase] == ids for phrase, ids in old.lexicon.items())
    assert config.max_timesteps == 40
    ours, theirs = (made.policy.network.language.encoder.embedding.weight for made in (after, before))
    assert torch.equal(ours[: len(theirs)], theirs)
    assert ours[len(theirs) :].std() > 0.1  # fresh
    bounds = after.postprocessor(after.policy.network.head.bounds)
    stats = after.dataset.meta.stats["action"]
    torch.testing.assert_close(bounds, torch.tensor(np.stack([stats["min"], stats["max"]])).float())


@BOTH
def test_new_words_are_heard_after_saving_and_loading(kind: str, continuous: Path, tmp_path: Path) -> None:
    """LeRobot keeps the old checkpoint's tokenizer, to which the new words are one and the same."""
    checkpoint = save(training(kind, continuous).warm_up(), tmp_path / "before")
    tuned = FineTuning(checkpoint, other_dataset(tmp_path / "data", "push the cube sphere")).warm_up()
    again = save(tuned, tmp_path / "after")
    cfg = PreTrainedConfig.from_pretrained(again)
    loaded = type(tuned.policy).from_pretrained(again, config=cfg)
    preprocess, _ = make_pre_post_processors(cfg, pretrained_path=str(again))

    words = [
        loaded.instructions.read(preprocess({"observation.state": torch.zeros(1, 3), "task": task}))[0].tolist()
        for task in ("push the cube", "push the sphere")
    ]

    assert words[0] != words[1]
    assert all(1 not in row for text in words for row in text)


def test_resuming_changes_nothing(continuous: Path, tmp_path: Path) -> None:
    before = training("lisa", continuous).warm_up()

    after = FineTuning(save(before, tmp_path / "before"), continuous)

    assert after.policy.config.vocabulary == before.policy.config.vocabulary
    assert after.policy.config.lexicon == before.policy.config.lexicon
    for key, value in before.policy.state_dict().items():
        assert torch.equal(after.policy.state_dict()[key], value), key


def test_what_cannot_fit_is_one_line(continuous: Path, symbolic: Path, tmp_path: Path) -> None:
    checkpoint = save(training("lisa", continuous).warm_up(), tmp_path / "before")

    with pytest.raises(UserError, match=r"action"):
        FineTuning(checkpoint, symbolic)


def test_other_joints_under_the_same_name_are_one_line(continuous: Path, tmp_path: Path) -> None:
    checkpoint = save(training("lisa", continuous).warm_up(), tmp_path / "before")
    features = {"observation.state": {**tiny_datasets.STATE, "shape": (2,), "names": ["x", "y"]}}
    other = tiny_datasets.write(tmp_path / "data", {**features, "action": tiny_datasets.MOVE})

    with pytest.raises(
        UserError, match=r"`observation\.state` has shape \(2,\) in .*, but the policy takes \(3,\): take"
    ):
        FineTuning(checkpoint, other)


def test_two_cameras_of_one_shape_are_told_apart_by_what_they_show(tmp_path: Path) -> None:
    """`--rename_map` in LeRobot's textbook case: nothing but the batch shows which camera became which."""
    top, wrist = "observation.images.top", "observation.images.wrist"
    root = tiny_datasets.write(
        tmp_path / "data", {top: tiny_datasets.CAMERA, wrist: tiny_datasets.CAMERA, "action": tiny_datasets.MOVE}
    )
    names = {wrist: "observation.images.camera1", top: "observation.images.camera2"}
    made = training("lang_dt", root, dropout=0.0)
    batch = made.batch(made.first_frames())
    made.policy.config.input_features = {names[key]: value for key, value in made.policy.config.input_features.items()}

    shown = RenameObservationsProcessorStep(names).observation(batch)
    store = made.policy.frames.episodes(shown, torch.device("cpu"))

    for key in names:
        stored = store.columns[names[key]][made.first_frames()].float() / 255
        torch.testing.assert_close(stored, batch[key])


@BOTH
def test_a_camera_that_nobody_looked_at(kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It cannot be looked at any more, which is said; whoever trains from nothing has chosen cameras by hand."""
    top, wrist = "observation.images.top", "observation.images.wrist"
    features = {top: tiny_datasets.CAMERA, "action": tiny_datasets.MOVE}
    one = tiny_datasets.write(tmp_path / "one", features)
    two = tiny_datasets.write(tmp_path / "two", {**features, wrist: tiny_datasets.CAMERA})

    with caplog.at_level(logging.WARNING):
        checkpoint = save(training(kind, one).warm_up(), tmp_path / "before")
        FineTuning(checkpoint, one).warm_up()
        assert "trained without" not in caplog.text
        FineTuning(checkpoint, two).warm_up()

    (said,) = [line for line in caplog.messages if "trained without" in line]
    assert said == (
        f"{two}: the checkpoint was trained without `{wrist}` and goes on without: only a new policy can use it"
    )


@BOTH
def test_instructions_with_words_that_nobody_taught(
    kind: str, continuous: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = training(kind, continuous).warm_up()

    with caplog.at_level(logging.WARNING):
        for task in ("go to the purple ball", "go to the purple ball", "  ", "go"):
            made.policy.reset()
            made.policy.select_action(made.preprocessor({"observation.state": torch.zeros(1, 3), "task": task}))

    said = [record.message for record in caplog.records if "instruction" in record.message]
    assert said == [
        "instruction 'go to the purple ball': no training instruction has purple",
        "the instruction is blank: say what is to be done, such as with --task",
    ]


def test_a_fine_tuned_checkpoint_is_read_by_the_analyses(continuous: Path, tmp_path: Path) -> None:
    checkpoint = save(training("lisa", continuous).warm_up(), tmp_path / "before")
    tuned = FineTuning(checkpoint, other_dataset(tmp_path / "data")).warm_up()
    again = save(tuned, tmp_path / "after")

    policy = load_checkpoint(load_config(str(again)), dataset=training("lisa", continuous).dataset.meta).policy

    assert policy.config.vocabulary == tuned.policy.config.vocabulary
    assert policy.config.lexicon == tuned.policy.config.lexicon


def test_new_phrases_for_a_pretrained_encoder_whose_folder_is_gone(
    encoder: Path, continuous: Path, tmp_path: Path
) -> None:
    """The checkpoint brings weights and tokenizer; phrases that codes may be called are looked up with the latter."""
    made = training("lisa", continuous, language_encoder=str(encoder), freeze_language_encoder=True).warm_up()
    checkpoint = save(made, tmp_path / "before")
    shutil.rmtree(encoder)

    tuned = FineTuning(checkpoint, other_dataset(tmp_path / "data", "go to the open door")).warm_up()

    new = set(tuned.policy.config.lexicon) - set(made.policy.config.lexicon)
    assert "open door" in new
    assert all(tuned.policy.config.lexicon[phrase] for phrase in new)
