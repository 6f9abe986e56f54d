"""Instructions to token ids: every word of the training instructions is known, and the step carries its tokenizer."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from lerobot.lerobot_types import TransitionKey
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_processor import LONGEST, InstructionStep, build_vocabulary, word_tokenizer

TEXTS = ["go to the Red ball", "open a door, then go", ""]


def tokenised(step: InstructionStep, task: object) -> tuple[Tensor, Tensor]:
    complementary = {} if task is None else {"task": task}
    out = step({TransitionKey.OBSERVATION: {}, TransitionKey.COMPLEMENTARY_DATA: complementary})
    observation = out[TransitionKey.OBSERVATION]
    return observation[OBS_LANGUAGE_TOKENS], observation[OBS_LANGUAGE_ATTENTION_MASK]


def step_for(texts: list[str]) -> InstructionStep:
    return InstructionStep(word_tokenizer(build_vocabulary(texts)))


def test_vocabulary_is_words_in_lower_case() -> None:
    assert build_vocabulary(TEXTS) == [",", "a", "ball", "door", "go", "open", "red", "the", "then", "to"]
    assert build_vocabulary(["b b b a a c"], limit=2) == ["a", "b"]


def test_tokens_and_mask() -> None:
    tokens, valid = tokenised(step_for(TEXTS), TEXTS)

    assert tokens.shape == valid.shape == (3, 6)
    assert valid.sum(1).tolist() == [5, 6, 1]  # an empty instruction still is one token
    assert tokens.dtype == torch.int64
    assert valid.dtype == torch.bool
    assert (tokens[~valid] == 0).all()
    assert (tokens[0, :5] > 1).all()
    assert tokens[2, 0] == 1


def test_unknown_words_share_a_token() -> None:
    tokens, _ = tokenised(step_for(TEXTS), ["go to the moon", "go to the sun", "GO TO THE BALL"])

    assert torch.equal(tokens[0], tokens[1])
    assert tokens[0, 3] == 1
    assert (tokens[2] > 1).all()


@given(st.lists(st.text(max_size=30), min_size=1, max_size=5))
def test_no_training_instruction_has_an_unknown_word(texts: list[str]) -> None:
    tokens, valid = tokenised(step_for(texts), texts)

    for text, row, real in zip(texts, tokens, valid, strict=True):
        nothing = not build_vocabulary([text])  # no word at all counts as one unknown word
        assert (row[real] > 1).all() or (nothing and row[real].tolist() == [1]), text


@pytest.mark.parametrize("text", ["लाल गेंद उठाओ", "Η ΜΠΑΛΑ ΕΙΝΑΙ ΚΟΚΚΙΝΟΣ", "İstanbul'a git", "拿起红球"])  # noqa: RUF001
def test_other_scripts(text: str) -> None:
    tokens, _ = tokenised(step_for([text]), text)

    assert (tokens > 1).all()


def test_long_instructions_are_cut() -> None:
    tokens, _ = tokenised(step_for(["go"]), "go " * 2 * LONGEST)

    assert tokens.shape == (1, LONGEST)


def test_state_round_trip() -> None:
    step, other = step_for(TEXTS), InstructionStep()
    assert step.get_config() == {}
    state = {key: value.clone() for key, value in step.state_dict().items()}

    other.load_state_dict(state)

    for one, two in zip(tokenised(step, TEXTS), tokenised(other, TEXTS), strict=True):
        assert torch.equal(one, two)
    other.load_state_dict(step_for(["quite different words"]).state_dict())
    assert not torch.equal(tokenised(step, TEXTS)[0], tokenised(other, TEXTS)[0])  # nothing remembered


def test_each_instruction_is_tokenised_once() -> None:
    step = step_for(TEXTS)
    tokenised(step, TEXTS)
    expected = tokenised(step, TEXTS)
    step.tokenizer = None  # it would fail if it were asked again

    for one, two in zip(tokenised(step, TEXTS), expected, strict=True):
        assert torch.equal(one, two)


def test_no_instruction_is_a_user_error() -> None:
    with pytest.raises(UserError, match="no instruction"):
        tokenised(step_for(TEXTS), None)
