"""What pages say can be followed: links lead somewhere, files that are named exist, options are options, lines fit."""

import re
import shlex
import typing
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path

import pytest
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig

import lerobot_lisa
from lerobot_lisa.analysis.control.rollout import RolloutConfig
from lerobot_lisa.analysis.listening.command import HeardConfig
from lerobot_lisa.analysis.report.command import ReportConfig
from lerobot_lisa.analysis.unseen import UnseenConfig

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LONGEST = 140  # characters of a line
NUMBERS = ("results.md", "history.md")  # pages whose lines published numbers decide, as they do
TABLES_OF_NUMBERS = ("README.md", "performance.md")  # in the tables of these
PROGRAMS = {
    "lerobot-train": TrainPipelineConfig,
    "lerobot-eval": EvalPipelineConfig,
    "lisa-report": ReportConfig,
    "lisa-rollout": RolloutConfig,
    "lisa-diagnose": HeardConfig,
    "lisa-unseen": UnseenConfig,
    "lerobot_lisa.analysis.annotations": "__main__:AnnotationsConfig",
    "lerobot_lisa.analysis.skills": "__main__:SkillsConfig",
    "lerobot_lisa.analysis.success": "__main__:SuccessConfig",
    "lerobot_lisa.analysis.training": "__main__:TrainingConfig",
    "lerobot_lisa.analysis.lorel_random_floor": "FloorConfig",
}
CHOICES = {
    "policy": [
        lerobot_lisa.LisaConfig,
        lerobot_lisa.LangDTConfig,
        lerobot_lisa.BabyAIRNNConfig,
        lerobot_lisa.LangBCConfig,
        lerobot_lisa.LorelPlannerConfig,
        lerobot_lisa.KMeansSkillsConfig,
    ],
    "env": [lerobot_lisa.BabyAIEnvConfig, lerobot_lisa.LorelEnvConfig, lerobot_lisa.MetaworldStatesConfig],
}
BY_LEROBOT = {"policy.path", "policy.type", "env.type", "config_path", "help"}
MADE = {"outputs", "data", "quickstart", "trace", "videos", "figures", "meta", "pretrained_model", "checkpoints"}

pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


@pages
def test_lines_fit(page: Path) -> None:
    if page.name in NUMBERS:
        return
    lines = page.read_text(encoding="utf-8").splitlines()
    free = "| " if page.name in TABLES_OF_NUMBERS else "no line"
    assert not [line for line in lines if len(line) > LONGEST and not line.startswith(free)]


@pages
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(\s*([^)\s]+)\s*\)", page.read_text(encoding="utf-8")):
        path, _, anchor = link.partition("#")
        if path.startswith(("http://", "https://")):
            continue
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor:
            assert anchor in headings(target), link


def headings(page: Path) -> set[str]:
    """The anchors that GitHub gives a page's headings."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pages
def test_files_that_are_named_exist(page: Path) -> None:
    """Paths of the repository, from its top or from `lerobot_lisa/`; not those that commands make."""
    named = re.findall(r"`((?:[\w.-]+/)+[\w.-]*)(?:::\w+)?`", page.read_text(encoding="utf-8"))
    for name in named:
        first = name.split("/")[0]
        if first in MADE or not (is_one_of_ours(first) or name.endswith((".py", ".yaml", ".md"))):
            continue
        assert any((top / name).exists() for top in (ROOT, ROOT / "lerobot_lisa", page.parent)), name


def is_one_of_ours(folder: str) -> bool:
    return (ROOT / folder).is_dir() or (ROOT / "lerobot_lisa" / folder).is_dir()


@pages
def test_options_in_commands_exist(page: Path) -> None:
    for words in commands(page):
        known = options_of(words)
        for option in (re.match(r"--([\w.-]+)", word) for word in words):
            if known is not None and option and option[1] not in known:
                pytest.fail(f"{' '.join(words[:4])} ... has no --{option[1]}")


@pages
def test_settings_of_policies_and_worlds_exist(page: Path) -> None:
    """Wherever a page names one, in sentences too."""
    for group, name in re.findall(r"--(policy|env)\.(\w+)", page.read_text(encoding="utf-8")):
        assert f"{group}.{name}" in chosen(group) | BY_LEROBOT, f"--{group}.{name}"


def commands(page: Path) -> Iterator[list[str]]:
    """Of a page's shell snippets, the words of each line."""
    for snippet in re.findall(r"```bash\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        for line in snippet.replace("\\\n", " ").splitlines():
            yield shlex.split(re.sub(r"\[(--[^\]]*)\]", r"\1", line), comments=True)


def options_of(words: list[str]) -> set[str] | None:
    """What a command's program takes; None: it is nobody's here."""
    for program, config in PROGRAMS.items():
        if program in words:
            made = config if is_dataclass(config) else named(program, config)
            return set(dotted(made)) | BY_LEROBOT
    if words[:1] == ["lisa-reproduce"]:
        return set(
            re.findall(r'"--([\w-]+)"', (ROOT / "lerobot_lisa/reproduce/command.py").read_text(encoding="utf-8"))
        )
    module = words[2] if words[:2] == ["python", "-m"] else words[1] if words[:1] == ["python"] else ""
    folder = re.match(r"(dataset_converters|benchmarks)(?:[./](\w+))?", module)
    if not folder:
        return None
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / folder[1]).glob("**/*.py"))
    return set(re.findall(r'"--([\w-]+)"', sources))


def named(program: str, config: str) -> type:
    """The dataclass of a module that `python -m` runs."""
    module, _, name = config.rpartition(":")
    return getattr(import_module(f"{program}.{module}" if module else program), name)


def dotted(config: type, prefix: str = "") -> Iterator[str]:
    """Options of a dataclass as LeRobot's parser writes them."""
    hints = typing.get_type_hints(config)
    for field in fields(config):
        name = f"{prefix}{field.name}"
        yield name
        yield from chosen(field.name) if field.name in CHOICES and not prefix else ()
        for kind in (hints[field.name], *typing.get_args(hints[field.name])):
            if is_dataclass(kind) and field.name not in CHOICES:
                yield from dotted(typing.cast(type, kind), f"{name}.")


def chosen(group: str) -> set[str]:
    """Options of all policies, or of all worlds."""
    return {f"{group}.{field.name}" for config in CHOICES[group] for field in fields(config)}
