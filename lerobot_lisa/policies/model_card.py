"""Model cards for the Hub: what the policy is, where it comes from, how to run it."""

import re
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from huggingface_hub import ModelCard, ModelCardData

from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig

if TYPE_CHECKING:
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

SUMMARIES = {
    "lisa": "A LISA policy: it turns an instruction into skill codes, and each code into a few steps of actions.",
    "lang_dt": "A Lang-DT policy: the flat language-conditioned Decision Transformer that LISA is compared with.",
    "babyai_rnn": "A BabyAI-RNN policy: BabyAI's own baseline, FiLM and an LSTM, as of BabyAI 1.1 (arXiv:2007.12770).",
    "kmeans_skills": "Skills by k-means on language and states: what LISA's learned codebook is compared with.",
    "lorel_planner": "LOReL's planner: a learned reward and model, and the cross-entropy method (arXiv:2109.01115).",
    "lang_bc": "A Lang-BC policy: LOReL's language-conditioned behaviour cloning (arXiv:2109.01115).",
}
SHOWN = (
    "horizon", "codebook_size", "memory_width", "code_width", "n_predictor_layers", "n_policy_layers", "n_layers",
    "dim_model", "n_heads", "dropout", "language_encoder", "optimizer_lr", "optimizer_lr_skill_predictor",
)  # fmt: skip
EXAMPLES = 5  # instructions shown; a dataset may have 100,000
LONGEST = 100  # characters of an instruction or a name


def make_model_card(
    config: EpisodePolicyConfig,
    dataset_repo_id: str,
    license: str | None,
    tags: list[str] | None,
    train: "TrainPipelineConfig | None",
    dataset: "LeRobotDatasetMetadata | None",
) -> ModelCard:
    """Fill the template. It is not validated online: that would ask a fixed host even when pushing to another one."""
    data = ModelCardData(
        license=license or "apache-2.0",
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted({*(tags or []), "robotics", "lerobot", "imitation-learning", config.type, "arxiv:2203.00054"}),
        model_name=config.type,
        datasets=dataset_repo_id,
    )
    template = files("lerobot_lisa.policies").joinpath("model_card.md").read_text(encoding="utf-8")
    return ModelCard.from_template(data, template_str=template, **_context(config, train, dataset))


def _context(
    config: EpisodePolicyConfig, train: "TrainPipelineConfig | None", dataset: "LeRobotDatasetMetadata | None"
) -> dict[str, Any]:
    env = getattr(train, "env", None)
    return {
        "title": plain(config.repo_id or config.type),
        "repo_id": plain(config.repo_id or "path/or/repo"),
        "type": config.type,
        "summary": SUMMARIES.get(config.type, ""),
        "env_type": plain(getattr(env, "type", "babyai")),
        "env_task": plain(getattr(env, "task", "GoToLocal")),
        "settings": [(name, plain(getattr(config, name))) for name in SHOWN if hasattr(config, name)],
        "dataset": _describe(dataset),
        "training": train and {"steps": train.steps, "batch_size": train.batch_size, "seed": train.seed},
    }


def _describe(dataset: "LeRobotDatasetMetadata | None") -> dict[str, Any] | None:
    if dataset is None:
        return None
    return {
        "repo_id": plain(dataset.repo_id),
        "episodes": dataset.total_episodes,
        "frames": dataset.total_frames,
        "instructions": len(dataset.tasks),
        "examples": [plain(task) for task in dataset.tasks.index[:EXAMPLES]],
    }


def plain(text: object) -> str:
    """One short line that means nothing in Markdown, HTML or a table: a dataset's words are anybody's.

    What could mean something gives way to a blank; backticks around what is left make the rest literal.
    """
    line = " ".join(re.sub(r"[`|<>\\\x00-\x1f\x7f-\x9f\u2028\u2029]", " ", str(text)[: 4 * LONGEST]).split())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]}..."
