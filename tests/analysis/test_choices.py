"""Statistics of skill codes on a hand-made trace."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from report_pages import trace_of

from lerobot_lisa.analysis.drawing import styled
from lerobot_lisa.analysis.material import Material
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.skills import answers
from lerobot_lisa.analysis.skills.choices import Choices, actions_by_code, begun, choices, over_time, transitions
from lerobot_lisa.analysis.training_data import TrainingData

HORIZON, SIZE = 2, 4
CODES = {0: [2, 2, 0], 1: [2, 1]}  # of the chunks of two episodes; the last chunk of each is one step long


@pytest.fixture
def trace() -> Trace:
    rows = [
        ("lorel", 3, episode, 1000 + episode, step, "go", code, [float(code), -float(step)], False)
        for episode, codes in CODES.items()
        for step, code in enumerate(np.repeat(codes, HORIZON)[:-1])
    ]
    names = ["group", "task_id", "episode", "seed", "step", "instruction", "code", "action", "success"]
    steps = pd.DataFrame(rows, columns=names)
    episodes = pd.DataFrame({"group": ["lorel"] * 2, "task_id": [3, 3], "episode": [0, 1]})
    return Trace(steps, episodes, {"policy": {"horizon": HORIZON, "codebook_size": SIZE}})


@pytest.fixture
def made(trace: Trace) -> Choices:
    return choices(trace)


def test_one_choice_for_each_chunk(made: Choices) -> None:
    assert list(made.table["code"]) == [2, 2, 0, 2, 1]
    assert list(made.table["episode"]) == [0, 0, 0, 1, 1]
    assert made.counts.tolist() == [[1, 0, 2, 0], [0, 1, 1, 0]]
    assert made.dead == [3]
    assert made.used.tolist() == [[1, 0, 1, 0], [0, 1, 1, 0]]
    assert made.first.tolist() == [[0, 0, 1, 0], [0, 0, 1, 0]]


def test_skills_are_counted_where_they_begin(trace: Trace, made: Choices) -> None:
    """With learned termination a code that is said again goes on, until its horizon at most."""
    assert begun(made, 1) == 5
    assert begun(made, 2) == 4
    often = replace(trace, origin={"policy": {"horizon": 2, "termination_stride": 1, "codebook_size": SIZE}})
    assert often.question_stride == 1
    assert begun(choices(often), 2) == 5
    assert begun(choices(often), 4) == 4


def test_perplexity_is_two_to_the_entropy(made: Choices) -> None:
    shares = np.array([0.2, 0.2, 0.6])
    assert made.perplexity == pytest.approx(2 ** -(shares * np.log2(shares)).sum(), rel=1e-5)


def test_over_time(made: Choices) -> None:
    counts, width = over_time(made)
    assert width == 1
    assert counts.tolist() == [[0, 0, 1], [0, 1, 0], [2, 1, 0], [0, 0, 0]]
    coarse, width = over_time(made, most=2)
    assert width == 2
    assert coarse.tolist() == [[0, 1], [1, 0], [3, 0], [0, 0]]


def test_transitions_stay_within_episodes(made: Choices) -> None:
    counts = transitions(made)
    assert counts.sum() == 3
    assert (counts[2, 2], counts[2, 0], counts[2, 1]) == (1, 1, 1)


def test_actions(trace: Trace) -> None:
    shares = actions_by_code(trace, SIZE, classes=SIZE)
    assert shares[:3].tolist() == np.eye(SIZE)[:3].tolist()
    assert np.isnan(shares[3]).all()
    means = actions_by_code(trace, SIZE, classes=0)
    assert means[2].tolist() == [2.0, -np.mean([0, 1, 2, 3, 0, 1])]


def test_codes_are_called_as_the_trace_says(trace: Trace) -> None:
    """Their names come from the policy; K is how many there are, whatever the configuration calls a codebook."""
    names = ["0 go", "1 open", "2 red ball", "3 blue ball", "4 red box", "5 blue box"]
    named = Trace(trace.steps, trace.episodes, {**trace.origin, "codes": names})
    assert choices(trace).labels == ["0", "1", "2", "3"]
    assert choices(named).labels == names
    assert choices(named).counts.shape == (2, 6)
    assert choices(named).dead == [3, 4, 5]


def test_of_more_codes_than_a_figure_holds_the_rarest_are_left_out() -> None:
    """70 of 100 codes were used, one in each episode, but for code 99, to which the first goes over from code 30."""
    told = [f"word{number}" for number in range(70)]
    trace = trace_of(told, [0] * 70, 100, 4, 2, np.random.default_rng(0))
    steps = trace.steps.assign(code=trace.steps["episode"] + 30)
    steps.loc[(steps["episode"] == 0) & (steps["step"] > 1), "code"] = 99
    material = Material(replace(trace, steps=steps), TrainingData(None, None, ""), permutations=20)
    told_of = {answer.name: answer for answer in answers.answers(material)}
    with styled():
        usage, over_time, pairs, actions = told_of["codes"].plots
    assert "Left out: 30 codes that were never chosen and the 10 rarest." in usage.reading
    assert usage.table["skill_code"].tolist() == ["99", *map(str, range(31, 99)), "30"]  # the most frequent first
    assert len(usage.table) == 70
    for plot, axes in ((usage, 0), (over_time, 1), (pairs, 0), (actions, 0)):
        ticks = plot.figure.axes[axes].get_yticks() if plot is over_time else plot.figure.axes[axes].get_xticks()
        assert max(ticks) <= 59
    assert "The 10 rarest of those that were chosen are left out." in told_of["skills"].introduction
    assert [heading.label for heading in told_of["skills"].headings] == usage.table["skill_code"].tolist()[:60]
    assert "99% of all choices repeat" in pairs.reading  # 69 of 70 pairs


def test_of_a_few_codes_all_are_told_in_order(made: Choices) -> None:
    assert made.codes == [0, 1, 2, 3]
    assert made.left_out() == ""
