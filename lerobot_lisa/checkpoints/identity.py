"""Which checkpoint it is: what it holds, not what it is called."""

import hashlib
from typing import NamedTuple

from lerobot_lisa.checkpoints.files import CONFIG, WEIGHTS, Files, find
from lerobot_lisa.checkpoints.pipelines import POSTPROCESSOR, PREPROCESSOR, read_pipeline
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig


class Identity(NamedTuple):
    """Tells a checkpoint from every other one.

    Attributes:
        revision: Commit of the Hub's repository; None for a folder.
        sha256: Over configuration, weights, both pipelines and their tensors.
    """

    revision: str | None
    sha256: str


def identify(config: EpisodePolicyConfig) -> Identity:
    """Identity of the checkpoint that a configuration was loaded from.

    Raises:
        UserError: A file is missing or cannot be used.
    """
    return identity_of(find(str(config.pretrained_path), config.pretrained_revision))


def identity_of(files: Files) -> Identity:
    """Identity of a checkpoint's files."""
    pipelines = [read_pipeline(files, name) for name in (PREPROCESSOR, POSTPROCESSOR)]
    states = [name for pipeline in pipelines for name in pipeline.state_files]
    whole = hashlib.sha256()
    for name in (CONFIG, WEIGHTS, PREPROCESSOR, POSTPROCESSOR, *states):
        with files.path(name).open("rb") as file:
            whole.update(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return Identity(files.revision, whole.hexdigest())
