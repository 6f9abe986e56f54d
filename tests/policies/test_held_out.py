"""A validation asks for the loss of every held-out frame, and costs one pass over the held-out episodes."""

from pathlib import Path

import pytest
import torch
from tiny_policies import Training, training

BOTH = pytest.mark.parametrize("kind", ["lisa", "lang_dt"])
LONGEST = 4  # the episode of 23 steps


@torch.no_grad()
def validated(made: Training, episode: int, batch_size: int = 4) -> list[float]:
    """What LeRobot does with `--dataset.eval_split`."""
    made.policy.eval()
    first = made.first_frames()[episode]
    frames = range(first, first + 23)
    batches = [made.batch(frames[at : at + batch_size]) for at in range(0, len(frames), batch_size)]
    losses = [made.policy.forward(batch)[0].item() for batch in batches]
    made.policy.train()
    return losses


@BOTH
@pytest.mark.parametrize("settings", [{}, {"excerpt_steps": 6, "lookback_steps": 5}], ids=["whole", "parts"])
def test_each_part_is_computed_once(kind: str, settings: dict[str, int], pictures: Path) -> None:
    made = training(kind, pictures, **{"excerpt_steps": 0, **settings}).warm_up()
    predict, rows = made.policy.predict, []

    def counted(tokens, valid, frames, actions, packing):
        rows.append(packing.learned.total)
        return predict(tokens, valid, frames, actions, packing)

    made.policy.predict = counted
    validated(made, LONGEST)

    assert sum(rows) == 23


@BOTH
def test_the_losses_are_those_of_each_frame_alone(kind: str, pictures: Path) -> None:
    made = training(kind, pictures, excerpt_steps=6, lookback_steps=5).warm_up()

    expected = validated(made, LONGEST, batch_size=1)
    found = validated(made, LONGEST, batch_size=3)

    assert sum(found[i] for i in range(2)) / 2 == pytest.approx(sum(expected[:6]) / 6, rel=1e-5)


@BOTH
def test_other_weights_have_other_losses(kind: str, continuous: Path) -> None:
    made = training(kind, continuous).warm_up()
    before = validated(made, LONGEST)
    with torch.no_grad():
        made.policy.eval()
        for parameter in made.policy.parameters():
            parameter.mul_(1.1)

    assert validated(made, LONGEST) != before
    assert validated(made, LONGEST) == validated(made, LONGEST)
