"""What a report says: its sections, each a few figures, made from a trace."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from lerobot_lisa.analysis.figures import choices as choice_figures
from lerobot_lisa.analysis.figures import information as information_figures
from lerobot_lisa.analysis.figures import skill_words
from lerobot_lisa.analysis.figures.plot import Plot
from lerobot_lisa.analysis.figures.skill_sheet import skill_sheet
from lerobot_lisa.analysis.figures.success import success_plot
from lerobot_lisa.analysis.recording.frames import Example
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.report.training_data import TrainingData
from lerobot_lisa.analysis.statistics.breakdown import breakdowns
from lerobot_lisa.analysis.statistics.choices import Choices, actions_by_code, choices
from lerobot_lisa.analysis.statistics.information import (
    Information,
    entropy,
    language_information,
    one_hot,
    word_information,
)
from lerobot_lisa.analysis.statistics.words import top_words, word_table

NOTABLE = 1.05  # times as frequent as usual: what rounds to more than usual
FIRST, ALL = "words, first code", "words, all codes"
NAMES = {"lisa": "LISA", "lang_dt": "Lang-DT"}
WORLDS = {"babyai": "BabyAI", "lorel": "LOReL"}
NO_SKILLS = {
    "lisa": "This policy's skills are continuous, numbers of which no two are the same: there are no codes to show.",
    "lang_dt": "Lang-DT is flat: it acts on instructions and observations without skill codes: there are none to show.",
}
INFORMATION = (
    "Mutual information is how many bits about the code one learns from the language. Counted from few episodes it is "
    "never 0, so each number stands beside what the same count gives when instructions are dealt to other episodes. An "
    "episode's set of all codes is what the paper's heat maps count; in long episodes that is nearly all codes, "
    "whatever was asked for. Language that acts only together with what is seen (“turn left, for there is the red "
    "one”) does not show here: lisa-diagnose swap finds it."
)
WORDS = (
    "Each code that an episode used gets all words of its instruction, as in the paper: nobody knows which of them a "
    "skill stands for, so these maps are noisy where instructions are long."
)
SKILLS = (
    "The most frequent skill first. Numbers beside words are how many times as frequent as usual they are with this "
    "skill: 1.1 is next to nothing, 3 a skill of its own."
)


@dataclass(frozen=True)
class Skills:
    """Everything about skills that several sections need.

    Attributes:
        made: The choices of codes.
        words: W words of the instructions.
        table: How often each of E instructions has each word, (E, W).
        counts: Words by skill, (W, K), as the paper counts them.
        information: Mutual information between language and codes, by what is asked.
    """

    made: Choices
    words: list[str]
    table: np.ndarray
    counts: np.ndarray
    information: dict[str, Information]


def skills_of(trace: Trace, permutations: int) -> Skills:
    """Count words and choices, and ask what language tells; for a policy with skill codes."""
    made = choices(trace)
    instructions = trace.episodes["instruction"].astype(str).tolist()
    words, table = word_table(instructions)
    information = {
        FIRST: language_information(table, made.first, permutations),
        ALL: language_information(table, made.used, permutations),
        # Not of all codes: instructions differ in how long their episodes last, and so in how many codes they get.
        "instruction, first code": language_information(one_hot(instructions), made.first, permutations),
    }
    return Skills(made, words, table, table.T @ made.used, information)


def task(trace: Trace) -> str:
    """What was evaluated, in a few words."""
    named = str(trace.facts["env"].get("task") or trace.facts["env"]["type"])
    return named if len(named) <= 40 else named[:39] + "…"


def sample(trace: Trace) -> str:
    """How much was evaluated, for titles."""
    seeds = trace.episodes["seed"]
    return f"{task(trace)}, n = {len(seeds):,} episodes, seeds {seeds.min()} to {seeds.max()}"


def title(trace: Trace) -> str:
    """Of the page."""
    policy, world = trace.facts["policy"]["type"], trace.facts["env"]["type"]
    return f"{NAMES[policy]} on {WORLDS.get(world, world)} {task(trace)}"


def subtitle(trace: Trace) -> str:
    """What was counted."""
    seeds, tasks = trace.episodes["seed"], len(trace.episodes.groupby(["group", "task_id"], observed=True))
    of_tasks = "" if tasks == 1 else f" of {tasks} tasks"
    return (
        f"{len(seeds):,} episodes{of_tasks} with seeds {seeds.min()} to {seeds.max()}, "
        f"{trace.episodes['instruction'].nunique():,} different instructions, {len(trace.steps):,} steps."
    )


def origin(trace: Trace, data: TrainingData) -> list[tuple[str, str]]:
    """How the report can be made again: name and value."""
    facts = trace.facts
    options = {"n_episodes": facts["n_episodes"], "batch_size": facts["batch_size"], "seed": facts["seed"]}
    environment = {key: value for key, value in facts["env"].items() if not isinstance(value, (dict, list))}
    return [
        ("Checkpoint", facts["policy_path"]),
        ("Weights, SHA-256", str(facts["weights_sha256"])),
        ("Environment", ", ".join(f"{key}={value}" for key, value in environment.items() if value is not None)),
        ("Evaluation", ", ".join(f"{key}={value}" for key, value in options.items())),
        ("Action temperature", str(facts["policy"]["action_temperature"])),
        ("Training data", data.note),
        ("Versions", ", ".join(f"{name} {number}" for name, number in facts["versions"].items())),
    ]


def about_codes(trace: Trace) -> str:
    """What the figures about codes count."""
    failed = trace.episodes.loc[~trace.episodes["success"], "steps"].sum() / trace.episodes["steps"].sum()
    return (
        f"The skill predictor chooses a code every {trace.facts['policy']['horizon']} steps; the policy follows it and "
        f"never sees the instruction. These figures count all choices, {failed:.0%} of them in episodes that failed, "
        "which last longest."
    )


def success_plots(trace: Trace, data: TrainingData) -> Iterator[Plot]:
    """One figure for each way of taking the evaluation apart."""
    for name, rates in breakdowns(trace, data.instructions).items():
        yield success_plot(name, rates, sample(trace))


def word_plots(trace: Trace, skills: Skills) -> Iterator[Plot]:
    """The four heat maps."""
    yield from skill_words.plots(skills.words, skills.counts, sample(trace))


def information_plots(trace: Trace, skills: Skills, permutations: int) -> Iterator[Plot]:
    """What language, and each word, tells about the code."""
    yield information_figures.information_plot(skills.information, sample(trace))
    presence = (skills.table > 0).astype(np.int64)
    by_word = {
        FIRST: word_information(presence, skills.made.first, permutations),
        ALL: word_information(presence, skills.made.used, permutations),
    }
    yield information_figures.word_information_plot(skills.words, by_word, sample(trace))


def choice_plots(trace: Trace, skills: Skills, data: TrainingData) -> Iterator[Plot]:
    """Usage, usage over time, transitions, actions."""
    made, title = skills.made, sample(trace)
    yield choice_figures.usage_plot(made, title)
    yield choice_figures.over_time_plot(made, title)
    yield choice_figures.transition_plot(made, title)
    classes = trace.facts["policy"]["action_classes"] or 0
    values = actions_by_code(trace, made.size, classes)
    names = data.action_names if data.action_names and len(data.action_names) == values.shape[1] else None
    yield choice_figures.actions_plot(values, names or [str(i) for i in range(values.shape[1])], bool(classes), title)


@dataclass(frozen=True)
class SkillFacts:
    """What stands above a skill's figure.

    Attributes:
        code: The skill.
        episodes: How many used it.
        share: Of all choices.
        words: That set it apart, and how many times as frequent as usual they are.
    """

    code: int
    episodes: int
    share: float
    words: list[tuple[str, float]]


def skill_facts(skills: Skills, most: int = 6) -> list[SkillFacts]:
    """Facts of the codes that were used, the most frequent first."""
    counts = skills.made.counts
    chosen, episodes = counts.sum(0), (counts > 0).sum(0)
    words = [
        [(word, times) for word, times in listed if times >= NOTABLE]
        for listed in top_words(skills.words, skills.counts, most)
    ]
    order = [int(code) for code in np.argsort(-chosen, kind="stable") if chosen[code]]
    return [SkillFacts(code, int(episodes[code]), chosen[code] / chosen.sum(), words[code]) for code in order]


def skill_plots(skills: Skills, examples: Sequence[Example], font: Path | None) -> Iterator[Plot]:
    """Word cloud and frames of each skill, in the order of `skill_facts`."""
    for facts in skill_facts(skills):
        of_code = [example for example in examples if example.code == facts.code]
        yield skill_sheet(facts.code, skills.words, skills.counts, of_code, font)


def key_numbers(trace: Trace, skills: Skills | None) -> list[tuple[str, str, str]]:
    """What stands at the top: name, number, what it means."""
    overall = breakdowns(trace, None)["overall"].iloc[0]
    numbers = [
        (
            "Success",
            f"{overall['percent']:.1f} %",
            f"95 % interval {overall['low']:.1f} to {overall['high']:.1f}; n = {overall['episodes']:,}",
        )
    ]
    if not pd.isna(overall["random_actions"]):
        numbers.append(("Random actions", f"{overall['random_actions']:.1f} %", "in the same tasks"))
    if skills is None:
        return numbers
    made, found = skills.made, skills.information[FIRST]
    high = float(found.interval[1])
    entropy_bits = float(entropy(made.counts.sum(0).astype(np.float64)))
    return [
        *numbers,
        ("Codes in use", f"{made.size - len(made.dead)} of {made.size}", f"{len(made.dead)} never chosen"),
        ("Perplexity", f"{made.perplexity:.1f}", f"codes in effective use; {entropy_bits:.2f} bits a choice"),
        ("Words tell", f"{float(found.bits):.3f} bits", f"about the first code; chance gives up to {high:.3f}"),
    ]
