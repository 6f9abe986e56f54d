"""Language encoders on their own: padding changes nothing, frozen answers are remembered."""

from types import SimpleNamespace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lerobot_lisa.networks.language import LanguageEncoder, PretrainedEncoder, WordEncoder

TOKENS = torch.tensor([[4, 2, 7], [3, 0, 0], [4, 2, 0]])
VALID = torch.tensor([[1, 1, 1], [1, 0, 0], [1, 1, 0]], dtype=torch.bool)


class Model(nn.Module):
    """The protocol of a `transformers` encoder; every token sees all valid ones; counts what it is asked."""

    def __init__(self) -> None:
        super().__init__()
        self.config = SimpleNamespace(hidden_size=6)
        self.embedding, self.dropout = nn.Embedding(10, 6), nn.Dropout(0.5)
        self.asked = 0

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> SimpleNamespace:
        self.asked += len(input_ids)
        embedded = self.embedding(input_ids)
        mean = (embedded * attention_mask[..., None]).sum(1, keepdim=True)
        return SimpleNamespace(last_hidden_state=self.dropout(embedded + mean))


class SimpleModel(nn.Module):
    """A transformer layer over embeddings, with real matrix products."""

    def __init__(self, layer: nn.TransformerEncoderLayer) -> None:
        super().__init__()
        self.config, self.layer, self.embedding = SimpleNamespace(hidden_size=32), layer, nn.Embedding(10, 32)

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> SimpleNamespace:
        hidden = self.layer(self.embedding(input_ids), src_key_padding_mask=attention_mask == 0)
        return SimpleNamespace(last_hidden_state=hidden)


def encoders() -> dict[str, nn.Module]:
    torch.manual_seed(0)
    return {
        "words": WordEncoder(10, 6),
        "fine-tuned": PretrainedEncoder(Model(), frozen=False).eval(),
        "frozen": PretrainedEncoder(Model(), frozen=True).eval(),
    }


@pytest.mark.parametrize("kind", ["words", "fine-tuned", "frozen"])
def test_padding_and_company_change_nothing(kind: str) -> None:
    encoder = encoders()[kind]
    both = encoder(TOKENS, VALID)
    wider = encoder(F.pad(TOKENS, (0, 2), value=5), F.pad(VALID, (0, 2)))
    for out, out_wider in zip(both, wider, strict=True):  # tokens in context, and phrases
        assert out.shape == (3, 3, 6)
        torch.testing.assert_close(out[VALID], out_wider[:, :3][VALID])
    for row in range(3):
        alone = encoder(TOKENS[row : row + 1, : VALID[row].sum()], VALID[row : row + 1, : VALID[row].sum()])
        for out, out_alone in zip(both, alone, strict=True):
            torch.testing.assert_close(out[row][VALID[row]], out_alone[0])


@pytest.mark.parametrize("kind", ["words", "fine-tuned", "frozen"])
def test_names_lie_where_phrases_do(kind: str) -> None:
    """A name of two words is what an instruction that ends with them says there, for word embeddings exactly."""
    language = LanguageEncoder(encoders()[kind], 8, [[4], [4, 2], [7, 7, 3]]).eval()

    names = language.names()

    assert names.shape == (3, 6)
    if kind == "words":
        torch.testing.assert_close(names[1], language(TOKENS, VALID).phrases[0, 1])
        torch.testing.assert_close(names[0], language(TOKENS, VALID).phrases[0, 0])
    else:
        alone = language(torch.tensor([[4, 2]]), torch.ones(1, 2, dtype=torch.bool)).phrases[0]
        torch.testing.assert_close(names[1], alone.mean(0))


def test_no_names() -> None:
    assert LanguageEncoder(WordEncoder(10, 6), 8).names().shape == (0, 6)


@pytest.mark.parametrize("kind", ["words", "fine-tuned", "frozen"])
def test_word_order_or_context_matters(kind: str) -> None:
    encoder = encoders()[kind]
    out, _ = encoder(TOKENS, VALID)

    assert not torch.allclose(out[0, 0], out[2, 0])  # the same first word, another instruction


def test_a_frozen_encoder_is_asked_once_per_instruction() -> None:
    model = Model()
    encoder = PretrainedEncoder(model, frozen=True).train()

    first, _ = encoder(TOKENS, VALID)
    again, _ = encoder(TOKENS[[2, 0, 0, 1]], VALID[[2, 0, 0, 1]])

    assert model.asked == 3
    assert torch.equal(first[[2, 0, 0, 1]][VALID[[2, 0, 0, 1]]], again[VALID[[2, 0, 0, 1]]])
    assert not first.requires_grad
    assert not any(parameter.requires_grad for parameter in encoder.parameters())


def test_a_frozen_encoders_answers_do_not_depend_on_company() -> None:
    """To the last digit: a resumed run asks for the same instructions in other batches."""
    torch.manual_seed(0)
    layer = nn.TransformerEncoderLayer(32, 4, 64, batch_first=True)
    model = SimpleModel(layer)
    together, alone = PretrainedEncoder(model, frozen=True), PretrainedEncoder(model, frozen=True)

    out, _ = together(TOKENS, VALID)

    for row in range(3):
        words = int(VALID[row].sum())
        assert torch.equal(out[row, :words], alone(TOKENS[row : row + 1], VALID[row : row + 1])[0][0, :words])


def test_a_frozen_encoder_forgets_the_least_recent() -> None:
    model = Model()
    encoder = PretrainedEncoder(model, frozen=True, remembered=2)
    ask = [lambda row=row: encoder(TOKENS[row : row + 1], VALID[row : row + 1]) for row in range(3)]

    for row, asked in [(0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)]:
        ask[row]()
        assert model.asked == asked


def test_a_fine_tuned_encoder_has_dropout_and_gradients() -> None:
    model = Model()
    encoder = PretrainedEncoder(model, frozen=False).train()

    out, _ = encoder(TOKENS, VALID)

    assert not torch.equal(out, encoder(TOKENS, VALID)[0])
    out.sum().backward()
    assert model.embedding.weight.grad is not None


def test_a_fine_tuned_encoder_reads_each_instruction_of_a_batch_once() -> None:
    model = Model()
    PretrainedEncoder(model, frozen=False)(TOKENS[[0, 0, 1, 0]], VALID[[0, 0, 1, 0]])

    assert model.asked == 2


def test_every_token_is_kept() -> None:
    encoder = LanguageEncoder(WordEncoder(10, 6), 8)

    assert encoder(TOKENS, VALID).tokens.shape == (3, 3, 8)
