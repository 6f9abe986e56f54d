"""Events and the grammar of labels, on states made for the purpose and on the original's labels."""

import csv
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_lisa.envs.lorel.labels import EVENTS, NOTHING, describe, happened

SAMPLE = Path(__file__).parents[4] / "shared" / "data" / "lorel"
changes = st.lists(st.floats(-0.5, 0.5, width=32), min_size=6, max_size=6)


def after(change: list[float]) -> np.ndarray:
    return np.concatenate([np.zeros(9), change])


@pytest.mark.parametrize("name", EVENTS)
def test_each_event_needs_more_than_its_threshold_in_its_direction(name: str) -> None:
    event = EVENTS[name]
    for factor, expected in ((1.01, (name,)), (0.99, ()), (-0.99, ())):
        state = np.zeros(15)
        state[event.coordinate] = factor * event.sign * event.threshold
        assert happened(np.zeros(15), state) == expected
    assert event.threshold == (np.pi / 10 if "faucet" in name else 0.02)


def test_the_directions_are_those_of_the_picture() -> None:
    names = happened(np.zeros(15), after([0.03, 0.03, -0.03, -0.03, 0.4, -0.03]))
    assert set(names) == {
        "move white mug left",
        "move white mug down",
        "move black mug right",
        "move black mug up",
        "turn faucet left",
        "open drawer",
    }


@given(changes, st.integers(0, 9))
def test_a_label_says_all_that_happened_and_nothing_else(change: list[float], seed: int) -> None:
    label = describe(np.zeros(15), after(change), np.random.default_rng(seed))
    assert parse(label) == set(happened(np.zeros(15), after(change)))
    assert label == describe(np.zeros(15), after(change), np.random.default_rng(seed))


def test_orders_vary() -> None:
    state = after([0.03, 0.03, 0, 0, 0.4, 0.03])
    labels = {describe(np.zeros(15), state, np.random.default_rng(seed)) for seed in range(100)}
    assert len(labels) == 12  # three parts, two directions
    assert "close drawer and move white mug left and down and turn faucet left" in labels


def test_nothing() -> None:
    assert describe(np.zeros(15), np.zeros(15), np.random.default_rng(0)) == NOTHING


@pytest.mark.skipif(not SAMPLE.exists(), reason=f"no sample of the original data at {SAMPLE}")
def test_the_originals_labels_are_of_this_grammar() -> None:
    with h5py.File(SAMPLE / "data.hdf5") as file:
        states = file["sim/state"][:]
    with (SAMPLE / "labels.csv").open() as file:
        labels = [row["Text Description"].strip() for row in csv.DictReader(file)]
    assert len(labels) == len(states) == 20
    for label, episode in zip(labels, states, strict=True):
        assert parse(label) == set(happened(episode[0], episode[19]))


def parse(label: str) -> set[str]:
    """The events that a label names."""
    found = {name for name in EVENTS if "mug" not in name and name in label}
    for colour, words in re.findall(r"move (white|black) mug ((?:(?:left|right|up|down)(?: and )?)+)", label):
        found |= {f"move {colour} mug {word}" for word in re.findall(r"left|right|up|down", words)}
    return found
