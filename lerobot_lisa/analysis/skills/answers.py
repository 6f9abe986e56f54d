"""What a report says about skills: the codes, what language tells about them, their words, and skill by skill."""

from collections.abc import Iterator

import numpy as np

from lerobot_lisa.analysis.drawing import MOST_CODES, Plot
from lerobot_lisa.analysis.material import POLICIES, Answer, Heading, Material
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills import choices, information, looking, words
from lerobot_lisa.analysis.skills.sheets import skill_sheet
from lerobot_lisa.analysis.skills.words import SkillWords, top_words, word_table

NOTABLE = 1.05  # times as frequent as usual: what rounds to more than usual
FIRST, ALL = "words, first code", "words, all codes"
NO_CODES = (
    "There are no codes to show: this policy's skills are continuous, by its configuration or since training "
    "ended before codes were placed (--policy.quantizer_warmup_steps)."
)
NO_SKILLS = "{} is flat: it acts on instructions and observations without skill codes: there are none to show."
INFORMATION = (
    "Mutual information is how many bits about the code one learns from the language. Counted from few episodes it is "
    "never 0, so each number stands beside what the same count gives when instructions are dealt to other episodes. An "
    "episode's set of all codes is what the paper's heat maps count; in long episodes that is nearly all codes, "
    "whatever was asked for. Language that acts only together with what is seen (“turn left, for there is the red "
    "one”) does not show here: heard, above, finds it."
)
WORDS = (
    "Each code that an episode used gets all words of its instruction, as in the paper: nobody knows which of them a "
    "skill stands for, so these maps are noisy where instructions are long."
)
NO_WORDS = "No instruction of this evaluation has a word in it: there is nothing to count."
SKILLS = (
    "The most frequent skill first. Numbers beside words are how many times as frequent as usual they are with this "
    "skill: 1.1 is next to nothing, 3 a skill of its own."
)


def answers(material: Material) -> Iterator[Answer]:
    """What do the skills mean? One section that says so for a policy without skill codes."""
    trace, sample = material.trace, material.sample
    if material.looks and not trace.has_codes:
        yield looking.answer(material)
    if not trace.has_codes:
        kind = trace.origin["policy"]["type"]
        yield Answer("skills", "Skills", NO_CODES if kind == "lisa" else NO_SKILLS.format(POLICIES[kind]))
        return
    made = choices.choices(trace)
    instructions = trace.episodes["instruction"].astype(str).tolist()
    vocabulary, table = word_table(instructions)
    found = SkillWords(vocabulary, table.T @ made.used, made.labels)
    plots = choices.plots(trace, made, material.data.action_names, sample)
    yield Answer("codes", "Codes", _about_codes(material), plots, numbers=_about_choices(trace, made))
    yield _information(material, made, instructions, vocabulary, table)
    yield Answer("words", "Words and skills", WORDS if vocabulary else NO_WORDS, words.plots(found, sample))
    if material.looks:
        yield looking.answer(material)
    yield _skill_by_skill(material, made, found)


def _about_codes(material: Material) -> str:
    episodes = material.trace.episodes
    failed = episodes.loc[~episodes["success"], "steps"].sum() / episodes["steps"].sum()
    every, horizon = material.trace.question_stride, material.trace.origin["policy"]["horizon"]
    ends = "" if every == horizon else f" until it chooses another one, {horizon} steps at most"
    return (
        f"The skill predictor chooses a code every {every} steps; the policy follows it{ends} "
        f"and never sees the instruction. These figures count all choices, {failed:.0%} of them in episodes "
        "that failed, which last longest."
    )


def _about_choices(trace: Trace, made: choices.Choices) -> list[tuple[str, str, str]]:
    bits = float(information.entropy(made.counts.sum(0).astype(np.float64)))
    return [
        ("Codes in use", f"{made.size - len(made.dead)} of {made.size}", f"{len(made.dead)} never chosen"),
        ("Perplexity", f"{made.perplexity:.1f}", f"codes in effective use; {bits:.2f} bits a choice"),
        *_about_lengths(trace, made),
    ]


def _about_lengths(trace: Trace, made: choices.Choices) -> list[tuple[str, str, str]]:
    """How long skills last where that is learned."""
    every, horizon = trace.question_stride, trace.origin["policy"]["horizon"]
    if every == horizon:
        return []
    skills = choices.begun(made, horizon // every)
    return [("A skill lasts", f"{trace.episodes['steps'].sum() / skills:.1f} steps", f"on average, {horizon} at most")]


def _information(
    material: Material, made: choices.Choices, instructions: list[str], vocabulary: list[str], table: words.Counts
) -> Answer:
    """What language, and each word, tells about the code."""
    times, told = material.permutations, information.one_hot(instructions)
    asked = {
        FIRST: information.language_information(table, made.first, times),
        ALL: information.language_information(table, made.used, times),
        # Not of all codes: instructions differ in how long their episodes last, and so in how many codes they get.
        "instruction, first code": information.language_information(told, made.first, times),
    }
    bits, high = float(asked[FIRST].bits), float(asked[FIRST].interval[1])
    tells = ("Words tell", f"{bits:.3f} bits", f"about the first code; chance gives up to {high:.3f}")

    def plots() -> Iterator[Plot]:
        yield information.information_plot(asked, material.sample)
        presence = (table > 0).astype(np.int64)
        by_word = {
            name: information.word_information(presence, used, times)
            for name, used in ((FIRST, made.first), (ALL, made.used))
        }
        yield from information.word_plots(vocabulary, by_word, material.sample)

    return Answer("information", "Language and codes", INFORMATION, plots(), numbers=[tells])


def _skill_by_skill(material: Material, made: choices.Choices, found: SkillWords) -> Answer:
    """Word cloud and frames of the codes that were used, the most frequent first."""
    chosen, episodes = made.counts.sum(0), made.used.sum(0)
    order = [int(place) for place in np.argsort(-chosen, kind="stable") if chosen[place]][:MOST_CODES]
    telling = top_words(found, most=6)
    looks = {looker.label: looker.in_words() for looker in looking.found_in(material)}
    rarer = int((chosen > 0).sum()) - len(order)
    left_out = f" The {rarer:,} rarest of those that were chosen are left out." if rarer else ""
    headings = [
        Heading(
            found.labels[place],
            int(episodes[place]),
            chosen[place] / chosen.sum(),
            [(word, times) for word, times in telling[place] if times >= NOTABLE],
            looks.get(found.labels[place], ""),
        )
        for place in order
    ]
    examples = {
        made.codes[place]: [each for each in material.examples if each.code == made.codes[place]] for place in order
    }
    plots = (
        skill_sheet(code, place, found, examples[code], material.font)
        for place, code in zip(order, examples, strict=True)
    )
    return Answer("skills", "Skill by skill", SKILLS + left_out, plots, headings)
