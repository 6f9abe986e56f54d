"""A checkpoint is what it holds: any change to what a policy acts with is another checkpoint."""

import shutil
from pathlib import Path

import pytest
from checkpoint_copy import Copy

from lerobot_lisa.checkpoints.identity import identify
from lerobot_lisa.checkpoints.load import load_checkpoint, load_config


def test_a_copy_is_the_same_checkpoint(lisa: Path, copy: Copy) -> None:
    config = load_config(str(copy.folder))
    assert identify(load_config(str(lisa))) == identify(config) == load_checkpoint(config).identity
    assert identify(config).revision is None


@pytest.mark.parametrize("part", ["policy", "preprocessor", "postprocessor", "statistics", "settings"])
def test_every_part_counts(part: str, lisa: Path, copy: Copy) -> None:
    if part == "policy":
        copy.edit_tensors(
            "model.safetensors", lambda tensors: tensors["network.quantizer.quantizers.0._codebook.embed"].mul_(2)
        )
    elif part == "statistics":
        copy.edit_tensors("*_unnormalizer_processor*", lambda tensors: tensors["action.mean"].add_(1))
    elif part == "settings":
        copy.edit("config.json", lambda content: content.update(action_seed=1))
    else:
        copy.edit(f"policy_{part}.json", lambda content: content.update(name="renamed"))
    assert identify(load_config(str(copy.folder))) != identify(load_config(str(lisa)))


def test_what_a_policy_does_not_act_with_does_not_count(lisa: Path, copy: Copy) -> None:
    (copy.folder / "README.md").write_text("A card.")
    (copy.folder / "train_config.json").unlink()
    assert identify(load_config(str(copy.folder))) == identify(load_config(str(lisa)))


def test_a_snapshot_of_the_hub_is_pinned(lisa: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a connection the cache's last commit counts; a configuration keeps its commit."""
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    repository = tmp_path / "models--me--lisa"
    (repository / "refs").mkdir(parents=True)

    def push(commit: str) -> None:
        shutil.copytree(lisa, repository / "snapshots" / commit)
        (repository / "refs" / "main").write_text(commit)

    push("a" * 40)
    old = load_config("me/lisa")
    push("b" * 40)
    new = load_config("me/lisa")

    assert (identify(old).revision, identify(new).revision) == ("a" * 40, "b" * 40)
    assert identify(old).sha256 == identify(new).sha256
    assert identify(load_config("me/lisa", [f"--pretrained_revision={'a' * 40}"])) == identify(old)
    load_checkpoint(new)
