"""Makes a report from a trace: figures in a folder, and the page that shows them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from lerobot_lisa.analysis.recording.frames import Example
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.report import contents
from lerobot_lisa.analysis.report.page import FIGURES, Section, pictures, render
from lerobot_lisa.analysis.report.training_data import TrainingData
from lerobot_lisa.analysis.statistics.information import PERMUTATIONS

PAGE = "report.html"


def build(
    folder: Path,
    trace: Trace,
    data: TrainingData,
    examples: Sequence[Example] = (),
    permutations: int = PERMUTATIONS,
    font: Path | None = None,
) -> list[tuple[str, str, str]]:
    """Write `report.html` and `figures/` into a folder.

    Args:
        folder: Exists.
        trace: The evaluation.
        data: Of the training, for what was seen in it and for the names of actions.
        examples: Frames of chunks.
        permutations: Of instructions, to see what chance gives.
        font: TrueType file for word clouds; None: DejaVu Sans.

    Returns:
        The numbers at the top of the page: name, number, what it means.

    Raises:
        UserError: The font is none, or a library is missing.
    """
    skills = contents.skills_of(trace, permutations) if trace.has_codes else None
    drawn = pictures(contents.success_plots(trace, data), folder / FIGURES, with_tables=True)
    sections = [Section("success", "Success", data.note, drawn)]
    if skills is None:
        sections.append(Section("skills", "Skills", contents.NO_SKILLS[trace.facts["policy"]["type"]], []))
    else:
        sections += _about_skills(folder / FIGURES, trace, skills, data, examples, permutations, font)
    numbers = contents.key_numbers(trace, skills)
    page = render(
        sections,
        title=contents.title(trace),
        subtitle=contents.subtitle(trace),
        key_numbers=numbers,
        origin=contents.origin(trace, data),
    )
    (folder / PAGE).write_text(page, encoding="utf-8")
    return numbers


def _about_skills(
    folder: Path,
    trace: Trace,
    skills: contents.Skills,
    data: TrainingData,
    examples: Sequence[Example],
    permutations: int,
    font: Path | None,
) -> Iterator[Section]:
    drawn = pictures(contents.choice_plots(trace, skills, data), folder)
    yield Section("codes", "Codes", contents.about_codes(trace), drawn)
    drawn = pictures(contents.information_plots(trace, skills, permutations), folder)
    yield Section("information", "Language and codes", contents.INFORMATION, drawn)
    yield Section("words", "Words and skills", contents.WORDS, pictures(contents.word_plots(trace, skills), folder))
    drawn = pictures(contents.skill_plots(skills, examples, font), folder)
    yield Section("skills", "Skill by skill", contents.SKILLS, drawn, contents.skill_facts(skills))
