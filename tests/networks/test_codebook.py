"""The codebook: initialisation, revival, freezing, gradients; and the statistics on answers that are known."""

import copy
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tiny_networks import codebook
from torch import Tensor

from lerobot_lisa.networks.codebook import Codebook, codes_used, mutual_information, perplexity

SIZE, WIDTH = 6, 16


def make(**settings: float) -> Codebook:
    torch.manual_seed(0)
    return codebook(SIZE, WIDTH, **settings).train()


def clusters(rows: int = 50, spread: float = 0.01) -> Tensor:
    """`SIZE` clusters of `rows` embeddings each, one cluster after another."""
    random = torch.Generator().manual_seed(1)
    centres = torch.randn(SIZE, 1, WIDTH, generator=random) * 5
    return (centres + spread * torch.randn(SIZE, rows, WIDTH, generator=random)).flatten(0, 1)


def buffers(book: Codebook) -> dict[str, Tensor]:
    return {name: value.clone() for name, value in book.named_buffers()}


def test_the_first_batch_places_every_code_on_data() -> None:
    """k-means may give one cluster two codes and two clusters one, but most embeddings lie right at their code."""
    book, x = make(), clusters()

    book(x)
    out = book(x)

    assert len(out.codes.unique()) >= SIZE - 2
    assert out.distances.min(1).values.median() < out.distances.mean() / 1000


def test_codes_do_not_shrink_after_initialisation() -> None:
    """Means stored where sums are expected would shrink the codes at the first moving average."""
    book, x = make(decay=0.9), clusters()
    book(x)
    first = book.quantizer.codebook.norm(dim=-1).mean()
    for _ in range(5):
        book(x)

    assert book.quantizer.codebook.norm(dim=-1).mean() == pytest.approx(float(first), rel=0.1)


def test_dead_codes_come_back() -> None:
    book = make(decay=0.5, dead_code_threshold=1.0)
    book(clusters())
    for _ in range(20):  # only the first cluster is left: the other codes die
        book(clusters()[:50])
    assert (book.quantizer._codebook.cluster_size > 0.5).all()
    torch.manual_seed(0)
    for _ in range(5):
        used = len(book(torch.randn(200, WIDTH) * 5).codes.unique())
    assert used == SIZE


def test_without_a_threshold_dead_codes_stay_dead() -> None:
    book = make(decay=0.5, dead_code_threshold=0.0)
    book(clusters())
    for _ in range(20):
        book(clusters()[:50])

    assert int((book.quantizer._codebook.cluster_size > 0.5).sum()) <= 2


def test_evaluation_freezes_every_buffer() -> None:
    book = make()
    book(clusters())
    book.eval()
    frozen = buffers(book)

    first = book(torch.randn(40, WIDTH) * 20)
    second = book(torch.randn(40, WIDTH) * 20)

    assert not torch.equal(first.distances, second.distances)
    for name, value in book.named_buffers():
        assert torch.equal(value, frozen[name]), name


def test_evaluation_of_an_untrained_codebook_changes_nothing() -> None:
    """A rollout before any training must not count as the batch that the codes are placed on."""
    book = make().eval()
    untouched = buffers(book)

    book(torch.randn(40, WIDTH))

    for name, value in book.named_buffers():
        assert torch.equal(value, untouched[name]), name


def test_training_moves_the_codes() -> None:
    book = make(decay=0.9)
    book(clusters())
    before = book.quantizer.codebook.clone()

    book(clusters() + 1)

    assert not torch.equal(before, book.quantizer.codebook)


def test_state_dict_round_trip_is_exact() -> None:
    book = make()
    for seed in range(3):
        torch.manual_seed(seed)
        book(torch.randn(64, WIDTH))
    other = make()

    other.load_state_dict(copy.deepcopy(book.state_dict()))

    for name, value in book.named_buffers():
        assert torch.equal(dict(other.named_buffers())[name], value), name
    x = torch.randn(64, WIDTH)
    for each in (book, other):  # the next steps are the same too: no second initialisation
        torch.manual_seed(7)
        each(x)
    assert torch.equal(book.quantizer.codebook, other.quantizer.codebook)
    assert torch.equal(book.eval()(x).embeddings, other.eval()(x).embeddings)


def test_gradients_pass_straight_through() -> None:
    """The gradient of what comes out with respect to what went in is that of the two projections alone."""
    book = make()
    book(clusters())
    x = clusters()[::10].clone().requires_grad_()
    weights = torch.randn(len(x), WIDTH)

    (book(x).embeddings * weights).sum().backward()
    y = x.detach().clone().requires_grad_()
    (book.quantizer.project_out(book.quantizer.project_in(y)) * weights).sum().backward()

    torch.testing.assert_close(x.grad, y.grad)
    assert (x.grad.abs().sum(1) > 0).all()


def test_commitment_pulls_embeddings_to_their_codes() -> None:
    book = make()
    book(clusters())
    x = clusters().requires_grad_()

    book(x).commitment.backward()
    assert x.grad.abs().sum() > 0

    torch.manual_seed(0)
    far, near = book(clusters(spread=3.0)).commitment, book(clusters()).commitment
    assert far > near


def test_codes_are_the_nearest_and_embed_gives_what_the_policy_saw() -> None:
    book = make()
    book(clusters())
    book.eval()

    out = book(torch.randn(30, WIDTH) * 5)

    assert torch.equal(out.distances.argmin(1), out.codes)
    torch.testing.assert_close(book.embed(out.codes), out.embeddings)


@pytest.mark.parametrize("rows", [1, 2, SIZE - 1])
def test_fewer_embeddings_than_codes(rows: int) -> None:
    book = make()

    out = book(torch.randn(rows, WIDTH))

    assert out.codes.shape == (rows,)
    assert torch.isfinite(out.embeddings).all()
    assert torch.isfinite(out.commitment)
    assert all(torch.isfinite(value).all() for value in book.buffers())


def distances_to(codes: Tensor, far: float) -> Tensor:
    """Squared distances of embeddings that lie on their codes, all other codes being `far` away."""
    distances = torch.full((len(codes), SIZE), far)
    distances[torch.arange(len(codes)), codes] = 0
    return distances


def test_mutual_information_of_a_bijection_is_all_bits() -> None:
    codes = torch.arange(SIZE).repeat(4)

    assert mutual_information(distances_to(codes, 200.0)).item() == pytest.approx(math.log2(SIZE), abs=1e-5)


def test_mutual_information_of_one_code_or_no_choice_is_zero() -> None:
    assert mutual_information(distances_to(torch.zeros(9, dtype=torch.long), 200.0)).item() == pytest.approx(
        0, abs=1e-6
    )
    assert mutual_information(torch.zeros(9, SIZE)).item() == pytest.approx(0, abs=1e-6)
    same = torch.rand(1, SIZE).repeat(9, 1)  # whatever is said, the same distribution
    assert mutual_information(same).item() == pytest.approx(0, abs=1e-6)


def test_mutual_information_by_hand() -> None:
    """Two embeddings, two codes, probabilities 3/4 and 1/4: 1 bit minus H(1/4)."""
    distances = torch.tensor([[0.0, 2 * math.log(3)], [2 * math.log(3), 0.0]])
    entropy = -(0.75 * math.log2(0.75) + 0.25 * math.log2(0.25))

    assert mutual_information(distances).item() == pytest.approx(1 - entropy, abs=1e-6)


@given(st.sampled_from([0.0, 1e-30, 1e4, 1e10, 1e30, 3e38]), st.integers(1, 8))
def test_mutual_information_is_finite_at_any_distance(far: float, rows: int) -> None:
    information = mutual_information(distances_to(torch.arange(rows) % SIZE, far)).item()

    assert -1e-5 <= information <= math.log2(SIZE) + 1e-5


@given(st.lists(st.integers(0, SIZE - 1), min_size=1, max_size=40))
def test_perplexity_counts_codes_in_use(codes: list[int]) -> None:
    value = perplexity(torch.tensor(codes), SIZE).item()
    assert codes_used(torch.tensor(codes, dtype=torch.int64), SIZE) == len(set(codes))

    assert 1 - 1e-5 <= value <= len(set(codes)) + 1e-4


def test_perplexity_on_known_frequencies() -> None:
    assert perplexity(torch.tensor([3, 3, 3]), SIZE).item() == 1
    assert perplexity(torch.arange(SIZE), SIZE).item() == pytest.approx(SIZE)
    assert perplexity(torch.tensor([0, 0, 1, 2]), SIZE).item() == pytest.approx(2**1.5)
