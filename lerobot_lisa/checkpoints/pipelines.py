"""A checkpoint's pre- and postprocessor, built from our own list of steps.

LeRobot builds whatever class a pipeline's JSON names under "class" and looks at its type afterwards: such a file can
run any program. Here a pipeline must have the steps that `make_pipelines` of the policies gives it, by their registered
names, and the tensors are read by us from files beside it.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from lerobot.configs import NormalizationMode, PolicyFeature
from lerobot.processor import NormalizerProcessorStep, PolicyProcessorPipeline, UnnormalizerProcessorStep
from lerobot.processor.converters import (
    batch_to_transition,
    policy_action_to_transition,
    transition_to_batch,
    transition_to_policy_action,
)
from lerobot.utils.constants import (
    ACTION,
    OBS_LANGUAGE_TOKENS,
    POLICY_POSTPROCESSOR_DEFAULT_NAME,
    POLICY_PREPROCESSOR_DEFAULT_NAME,
)
from safetensors.torch import load_file
from torch import Tensor

from lerobot_lisa.checkpoints.files import RETAKE, Files, refusing
from lerobot_lisa.checkpoints.tokenizer import check_tokenizer
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.episode_settings import WORDS

PREPROCESSOR = f"{POLICY_PREPROCESSOR_DEFAULT_NAME}.json"
POSTPROCESSOR = f"{POLICY_POSTPROCESSOR_DEFAULT_NAME}.json"

_DEVICE, _TOKENIZER = "device_processor", "lisa_instructions"
_SCALING = {"eps", "features", "norm_map", "normalize_observation_keys"}
_STEPS: dict[str, dict[str, set[str]]] = {  # in order, with their settings
    PREPROCESSOR: {
        "rename_observations_processor": {"rename_map"},
        "to_batch_processor": set(),
        _TOKENIZER: set(),
        _DEVICE: {"device", "float_dtype"},
        "normalizer_processor": _SCALING,
    },
    POSTPROCESSOR: {"unnormalizer_processor": _SCALING, _DEVICE: {"device", "float_dtype"}},
}
_NEEDED = {
    NormalizationMode.IDENTITY: (),
    NormalizationMode.MEAN_STD: ("mean", "std"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}


class Written(NamedTuple):
    """A pipeline as its file has it, checked.

    Attributes:
        file: The file's name.
        content: Its JSON.
    """

    file: str
    content: dict[str, Any]

    @property
    def state_files(self) -> list[str]:
        """Names of the files with its tensors, in the order of the steps."""
        return [step["state_file"] for step in self.content["steps"] if "state_file" in step]


def read_pipeline(files: Files, name: str) -> Written:
    """Read a pipeline's JSON.

    Args:
        files: Of the checkpoint.
        name: `PREPROCESSOR` or `POSTPROCESSOR`.

    Raises:
        UserError: It has other steps than ours, or settings that they do not know.
    """
    content, path = files.json(name), files.path(name)
    steps = content.get("steps")
    if set(content) - {"name", "steps"} or not isinstance(steps, list):
        raise UserError(f"{path} has {sorted(content)!r:.200} where a pipeline has name and steps: {RETAKE}")
    found = [_registered_name(path, step) for step in steps]
    if found != list(_STEPS[name]):
        raise UserError(
            f"{path} has the steps {', '.join(found):.300}, a pipeline of these policies {', '.join(_STEPS[name])}: "
            f"{RETAKE}, or evaluate with lerobot-eval if you trust it"
        )
    for step in steps:
        _check_step(path, step, _STEPS[name][step["registry_name"]])
    return Written(name, content)


def load_pipelines(files: Files, config: EpisodePolicyConfig) -> tuple[PolicyProcessorPipeline, ...]:
    """Build both pipelines, their tensors included, and try them on zeros.

    Raises:
        UserError: A file is missing, is not what the policies write, or the pipeline cannot do its work.
    """
    before, after = (read_pipeline(files, name) for name in (PREPROCESSOR, POSTPROCESSOR))
    device = {_DEVICE: {"device": str(config.device)}}
    with refusing(f"{files.path(PREPROCESSOR)} cannot be used"):
        preprocess = PolicyProcessorPipeline.from_config(
            before.content,
            state_dict=dict(_states(files, before, config)),
            overrides=device,
            to_transition=batch_to_transition,
            to_output=transition_to_batch,
        )
        _check_scaling(preprocess.steps)
        _try_before(preprocess, config)
    with refusing(f"{files.path(POSTPROCESSOR)} cannot be used"):
        postprocess = PolicyProcessorPipeline.from_config(
            after.content,
            state_dict=dict(_states(files, after, config)),
            to_transition=policy_action_to_transition,
            to_output=transition_to_policy_action,
        )
        _check_scaling(postprocess.steps)
        _try_after(postprocess, config)
    return preprocess, postprocess


def stats_of(preprocess: PolicyProcessorPipeline) -> dict[str, Any] | None:
    """The statistics that a preprocessor scales with."""
    return next((step.stats for step in preprocess.steps if isinstance(step, NormalizerProcessorStep)), None)


def blank(preprocess: PolicyProcessorPipeline, config: EpisodePolicyConfig) -> dict[str, Any]:
    """A batch of one observation, all zeros, as an environment would give it to a preprocessor."""
    sources = {new: old for old, new in preprocess.steps[0].rename_map.items()}
    features: dict[str, PolicyFeature] = config.input_features or {}
    zeros = {sources.get(key, key): torch.zeros(1, *feature.shape) for key, feature in features.items()}
    known = " ".join(config.vocabulary[:3])[:100]  # of other words the policy would warn
    return {**zeros, "task": [known if known.strip() else "go to the red ball"]}


def _registered_name(path: Any, step: Any) -> str:
    if not isinstance(step, dict) or "class" in step or not isinstance(step.get("registry_name"), str):
        named = step.get("class") if isinstance(step, dict) else step
        raise UserError(f"{path} asks for the class {named!r:.100}, which would be run: do not use it; {RETAKE}")
    return step["registry_name"]


def _check_step(path: Any, step: dict[str, Any], known: set[str]) -> None:
    name, settings, state = step["registry_name"], step.get("config", {}), step.get("state_file", "")
    if set(step) - {"registry_name", "config", "state_file"}:
        raise UserError(f"{path}: the step {name} has {sorted(step)!r:.200}, which this does not know: {RETAKE}")
    if not isinstance(settings, dict) or set(settings) - known:
        raise UserError(f"{path}: the step {name} knows the settings {sorted(known)}, not {settings!r:.200}: {RETAKE}")
    renamed = settings.get("rename_map", {})
    if not isinstance(renamed, dict) or not all(isinstance(new, str) for new in renamed.values()):
        raise UserError(f"{path}: rename_map is no map of names: {RETAKE}")
    if not isinstance(state, str) or (
        state and name not in (_TOKENIZER, "normalizer_processor", "unnormalizer_processor")
    ):
        raise UserError(f"{path}: the step {name} has no tensors, but names the file {state!r:.100}: {RETAKE}")
    if name == _TOKENIZER and not state:
        raise UserError(f"{path}: the step {name} has lost its tokenizer (state_file): {RETAKE}")


def _states(files: Files, written: Written, config: EpisodePolicyConfig) -> Iterator[tuple[str, dict[str, Tensor]]]:
    """Tensors of a pipeline's steps, by the names LeRobot wants."""
    for step in written.content["steps"]:
        if "state_file" in step:
            path = files.path(step["state_file"])
            with refusing(f"{path} is no file of tensors"):
                tensors = load_file(path)
            if step["registry_name"] == _TOKENIZER:
                _check_tokenizer(path, tensors, config)
            elif unreal := [key for key, value in tensors.items() if not value.double().isfinite().all()]:
                raise UserError(f"{path}: {unreal[0]} is not finite: compute the dataset's statistics again, and train")
            yield path.name.removesuffix(".safetensors"), tensors


def _check_tokenizer(path: Any, tensors: dict[str, Tensor], config: EpisodePolicyConfig) -> None:
    if list(tensors) != ["tokenizer"] or tensors["tokenizer"].dtype != torch.uint8:
        raise UserError(f"{path} holds {list(tensors)!r:.100} where the bytes of a tokenizer belong: {RETAKE}")
    model = config.language_model or {}
    ids = len(config.vocabulary) + 2 if config.language_encoder == WORDS else model.get("vocab_size", 2**31)
    check_tokenizer(path, tensors["tokenizer"].numpy().tobytes(), ids)


def _check_scaling(steps: list[Any]) -> None:
    """LeRobot leaves a feature as it is, without a word, if there are no statistics of it."""
    for step in steps:
        if isinstance(step, NormalizerProcessorStep | UnnormalizerProcessorStep):
            for key, feature in step.features.items():
                mode = step.norm_map.get(feature.type, NormalizationMode.IDENTITY)
                missing = [name for name in _NEEDED[mode] if name not in step.stats.get(key, {})]
                if missing:
                    raise ValueError(f"{mode.value} of {key} lacks the statistics {', '.join(missing)}")


def _try_before(preprocess: PolicyProcessorPipeline, config: EpisodePolicyConfig) -> None:
    seen = preprocess(blank(preprocess, config))
    for key, feature in (config.input_features or {}).items():
        if key not in seen or seen[key].shape != (1, *feature.shape) or not seen[key].isfinite().all():
            raise ValueError(f"it gives the policy no finite {key} of shape {tuple(feature.shape)}")
    if OBS_LANGUAGE_TOKENS not in seen:
        raise ValueError("it gives the policy no instruction")


def _try_after(postprocess: PolicyProcessorPipeline, config: EpisodePolicyConfig) -> None:
    shape = (1, *(config.output_features or {})[ACTION].shape)
    action = postprocess(torch.zeros(shape))
    if action.shape != shape or not action.isfinite().all():
        raise ValueError(f"it makes no finite action of shape {shape[1:]}")
