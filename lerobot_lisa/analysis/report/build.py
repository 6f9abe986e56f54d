"""Strings the questions together: from a trace to a page and its figures."""

from collections.abc import Mapping
from pathlib import Path

from lerobot_lisa.analysis.listening import heard_figure as listening
from lerobot_lisa.analysis.listening.heard import Runs
from lerobot_lisa.analysis.material import POLICIES, Answer, Material
from lerobot_lisa.analysis.report.page import FIGURES, draw, render
from lerobot_lisa.analysis.skills import answers as skills
from lerobot_lisa.analysis.success import breakdown as success

PAGE = "report.html"
_WORLDS = {"babyai": "BabyAI", "lorel": "LOReL", "metaworld": "Meta-World", "metaworld_states": "Meta-World"}


def build(
    folder: Path, material: Material, runs: Runs | None = None, annotated: Answer | None = None
) -> list[tuple[str, str, str]]:
    """Write `report.html` and `figures/` into a folder.

    Args:
        folder: Exists.
        material: The evaluation.
        runs: The same episodes told otherwise; None: whether it listens was not asked.
        annotated: About skills and the subtasks of the training data; None: those have none.

    Returns:
        The numbers at the top of the page: name, number, what it means.

    Raises:
        UserError: A library is missing.
    """
    listens = [] if runs is None else [listening.answer(runs, material.sample)]
    beside = [] if annotated is None else [annotated]
    answers = [success.answer(material), *listens, *skills.answers(material), *beside]
    sections = draw(answers, folder / FIGURES)
    numbers = [number for section in sections for number in section.answer.numbers]
    page = render(
        sections, title=_title(material), subtitle=_subtitle(material), key_numbers=numbers, origin=_origin(material)
    )
    (folder / PAGE).write_text(page, encoding="utf-8")
    return numbers


def _title(material: Material) -> str:
    policy, world = material.trace.origin["policy"]["type"], str(material.trace.world)
    return f"{POLICIES[policy]} on {_WORLDS.get(world, world)} {material.task}"


def _subtitle(material: Material) -> str:
    """What was counted."""
    episodes, steps = material.trace.episodes, len(material.trace.steps)
    seeds, tasks = episodes["seed"], len(episodes.groupby(["group", "task_id"], observed=True))
    of_tasks = "" if tasks == 1 else f" of {tasks} tasks"
    return (
        f"{len(seeds):,} episodes{of_tasks} with seeds {seeds.min()} to {seeds.max()}, "
        f"{episodes['instruction'].nunique():,} different instructions, {steps:,} steps."
    )


def _origin(material: Material) -> list[tuple[str, str]]:
    """How the report can be made again: name and value."""
    origin = material.trace.origin
    environment = {key: value for key, value in origin["env"].items() if isinstance(value, (str, int, float))}
    options = {name: origin[name] for name in ("n_episodes", "batch_size", "seed")}
    return [
        ("Checkpoint", origin["policy_path"]),
        ("Checkpoint, SHA-256", origin["checkpoint"]["sha256"]),
        ("Environment", _listed(environment, "=")),
        ("Evaluation", _listed(options, "=")),
        ("Action temperature", str(origin["policy"]["action_temperature"])),
        ("Training data", material.data.note),
        ("Versions", _listed(origin["versions"], " ")),
    ]


def _listed(values: Mapping[str, object], between: str) -> str:
    return ", ".join(f"{name}{between}{value}" for name, value in values.items())
