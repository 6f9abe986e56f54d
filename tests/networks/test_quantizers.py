"""Quantisers: initialisation, warm-up, revival, freezing, gradients, codes of several parts."""

import copy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tiny_networks import codebook
from torch import Tensor

from lerobot_lisa.networks.codebooks import PLACED_ANEW, Codebook, CodebookSettings, ResidualCodebook, far_samples
from lerobot_lisa.networks.quantizers import Continuous, FiniteScalars, Quantized, Quantizer

SIZE, WIDTH = 6, 16


def make(**settings: float) -> Codebook:
    torch.manual_seed(0)
    return codebook(SIZE, WIDTH, **settings).train()


def quantise(book: Codebook, x: Tensor) -> Quantized:
    """Embeddings (N, E) of one part."""
    return book(x[:, None])


def clusters(rows: int = 50, spread: float = 0.01) -> Tensor:
    """`SIZE` clusters of `rows` embeddings each, one cluster after another."""
    random = torch.Generator().manual_seed(1)
    centres = torch.randn(SIZE, 1, WIDTH, generator=random) * 5
    return (centres + spread * torch.randn(SIZE, rows, WIDTH, generator=random)).flatten(0, 1)


def buffers(book: Codebook) -> dict[str, Tensor]:
    return {name: value.clone() for name, value in book.named_buffers()}


def test_the_first_batch_places_every_code_on_data() -> None:
    """Well-separated clusters get a code each."""
    book, x = make(), clusters()

    quantise(book, x)
    out = quantise(book, x)

    assert len(out.codes.unique()) == SIZE
    assert out.distances.min(1).values.max() < out.distances.mean() / 1000


def test_codes_do_not_shrink_after_initialisation() -> None:
    """Means stored where sums are expected would shrink the codes at the first moving average."""
    book, x = make(decay=0.9), clusters()
    quantise(book, x)
    first = book.quantizers[0].codebook.norm(dim=-1).mean()
    for _ in range(5):
        quantise(book, x)

    assert book.quantizers[0].codebook.norm(dim=-1).mean() == pytest.approx(float(first), rel=0.1)


def test_dead_codes_come_back() -> None:
    book = make(decay=0.5, dead_code_threshold=1.0)
    quantise(book, clusters())
    for _ in range(20):  # only the first cluster is left: the other codes die
        quantise(book, clusters()[:50])
    assert (book.quantizers[0]._codebook.cluster_size > 0.5).all()
    torch.manual_seed(0)
    for _ in range(5):
        used = len(quantise(book, torch.randn(200, WIDTH) * 5).codes.unique())
    assert used == SIZE


def test_without_a_threshold_dead_codes_stay_dead() -> None:
    book = make(decay=0.5, dead_code_threshold=0.0)
    quantise(book, clusters())
    for _ in range(20):
        quantise(book, clusters()[:50])

    assert int((book.quantizers[0]._codebook.cluster_size > 0.5).sum()) <= 2


def test_evaluation_freezes_every_buffer() -> None:
    book = make()
    quantise(book, clusters())
    book.eval()
    frozen = buffers(book)

    first = quantise(book, torch.randn(40, WIDTH) * 20)
    second = quantise(book, torch.randn(40, WIDTH) * 20)

    assert not torch.equal(first.distances, second.distances)
    for name, value in book.named_buffers():
        assert torch.equal(value, frozen[name]), name


def test_evaluation_of_an_untrained_codebook_changes_nothing() -> None:
    """A rollout before any training must not count as the batch that the codes are placed on."""
    book = make().eval()
    untouched = buffers(book)

    quantise(book, torch.randn(40, WIDTH))

    for name, value in book.named_buffers():
        assert torch.equal(value, untouched[name]), name


def test_training_moves_the_codes() -> None:
    book = make(decay=0.9)
    quantise(book, clusters())
    before = book.quantizers[0].codebook.clone()

    quantise(book, clusters() + 1)

    assert not torch.equal(before, book.quantizers[0].codebook)


def test_state_dict_round_trip_is_exact() -> None:
    book = make()
    for seed in range(3):
        torch.manual_seed(seed)
        quantise(book, torch.randn(64, WIDTH))
    other = make()

    other.load_state_dict(copy.deepcopy(book.state_dict()))

    for name, value in book.named_buffers():
        assert torch.equal(dict(other.named_buffers())[name], value), name
    x = torch.randn(64, WIDTH)
    for each in (book, other):  # the next steps are the same too: no second initialisation
        torch.manual_seed(7)
        quantise(each, x)
    assert torch.equal(book.quantizers[0].codebook, other.quantizers[0].codebook)
    assert torch.equal(quantise(book.eval(), x).embeddings, quantise(other.eval(), x).embeddings)


def test_gradients_pass_straight_through() -> None:
    """The gradient of what comes out with respect to what went in is that of the two projections alone."""
    book = make()
    quantise(book, clusters())
    x = clusters()[::10].clone().requires_grad_()
    weights = torch.randn(len(x), WIDTH)

    (quantise(book, x).embeddings[:, 0] * weights).sum().backward()
    y = x.detach().clone().requires_grad_()
    (book.quantizers[0].project_out(book.quantizers[0].project_in(y)) * weights).sum().backward()

    torch.testing.assert_close(x.grad, y.grad)
    assert (x.grad.abs().sum(1) > 0).all()


def test_commitment_pulls_embeddings_to_their_codes() -> None:
    book = make()
    quantise(book, clusters())
    x = clusters().requires_grad_()

    quantise(book, x).commitment.backward()
    assert x.grad.abs().sum() > 0

    torch.manual_seed(0)
    far, near = quantise(book, clusters(spread=3.0)).commitment, quantise(book, clusters()).commitment
    assert far > near


def test_codes_are_the_nearest_and_embed_gives_what_the_policy_saw() -> None:
    book = make()
    quantise(book, clusters())
    book.eval()

    out = quantise(book, torch.randn(30, WIDTH) * 5)

    assert torch.equal(out.distances.argmin(1), out.codes)
    torch.testing.assert_close(book.embed(out.codes), out.embeddings)


@pytest.mark.parametrize("rows", [1, 2, SIZE - 1])
def test_fewer_embeddings_than_codes(rows: int) -> None:
    book = make()

    out = quantise(book, torch.randn(rows, WIDTH))

    assert out.codes.shape == (rows,)
    assert torch.isfinite(out.embeddings).all()
    assert torch.isfinite(out.commitment)
    assert all(torch.isfinite(value).all() for value in book.buffers())


@pytest.mark.parametrize("seed", range(20))
def test_starting_points_of_k_means_are_one_in_each_cluster(seed: int) -> None:
    torch.manual_seed(seed)

    chosen = far_samples(clusters()[None], SIZE)[0]

    assert len({int((clusters().view(SIZE, 50, WIDTH)[:, 0] - point).norm(dim=1).argmin()) for point in chosen}) == SIZE


def test_starting_points_where_all_embeddings_are_the_same() -> None:
    assert torch.equal(far_samples(torch.ones(1, 3, 4), 5), torch.ones(1, 5, 4))


def test_codes_lie_among_the_embeddings_without_a_code_width() -> None:
    book = make(code_width=None)

    out = quantise(book, clusters())

    torch.testing.assert_close(out.embeddings[:, 0], clusters(), atol=0.1, rtol=0)


def test_embeddings_pass_as_they_are_until_codes_are_placed() -> None:
    book, x = make(warmup_steps=3), clusters()
    for _ in range(3):
        out = quantise(book, x)
        assert torch.equal(out.embeddings[:, 0], x)
        assert out.codes is None
        assert out.commitment == 0
    assert quantise(book.eval(), x).codes is None  # a rollout is no training step
    assert quantise(book.train(), x).codes is not None
    assert not torch.equal(quantise(book, x).embeddings[:, 0], x)


def test_the_warm_up_goes_on_after_a_resume() -> None:
    book, resumed = make(warmup_steps=3), make(warmup_steps=3)
    quantise(book, clusters())
    quantise(book, clusters())

    resumed.load_state_dict(book.state_dict())

    assert quantise(resumed, clusters()).codes is None
    assert quantise(resumed, clusters()).codes is not None


def test_before_the_first_training_step_there_are_no_codes() -> None:
    assert quantise(make().eval(), clusters()).codes is None


def test_codes_are_placed_anew_where_clusters_have_come_apart() -> None:
    """All embeddings are one cluster at first, and moving averages never part codes that lie on one another."""
    book = make(code_width=None, dead_code_threshold=0.0)
    quantise(book, clusters()[:50])
    book.steps.zero_()
    lost = [quantise(book, clusters()).distances.amin(1).mean() for _ in range(60)]

    assert lost[40] > 100 * lost[-1]
    assert len(quantise(book, clusters()).codes.unique()) == SIZE


def test_codes_that_serve_well_stay_where_they_are() -> None:
    book = make(code_width=None)
    quantise(book, clusters())
    before = quantise(book.eval(), clusters()).codes
    book.train()
    for _ in range(120):
        quantise(book, clusters())

    assert torch.equal(quantise(book.eval(), clusters()).codes, before)


def several() -> dict[str, Quantizer]:
    """Quantisers of more than one kind or part, having seen data."""
    torch.manual_seed(0)
    made: dict[str, Quantizer] = {
        "two parts": codebook(4, WIDTH, parts=2),
        "two parts among words": codebook(4, WIDTH, parts=2, code_width=None),
        "residual": ResidualCodebook(WIDTH, [4] * 3, CodebookSettings(0.9, 0.25, 1.0)),
        "residual, narrow": ResidualCodebook(WIDTH, [4, 3], CodebookSettings(0.9, 0.25, 1.0, code_width=3)),
        "finite scalars": FiniteScalars(WIDTH, [4, 3]),
    }
    for quantizer in made.values():
        for _ in range(3):
            quantizer.train()(inputs(quantizer))
    return {name: quantizer.eval() for name, quantizer in made.items()}


def inputs(quantizer: Quantizer, rows: int = 60) -> Tensor:
    parts = len(quantizer.sizes) if isinstance(quantizer, Codebook) else 1
    return torch.randn(rows, parts, WIDTH) * 3


@pytest.mark.parametrize("name", several())
def test_embed_gives_what_the_policy_saw(name: str) -> None:
    quantizer = several()[name]
    x = inputs(quantizer)

    out = quantizer(x)

    assert out.embeddings.shape == x.shape
    assert out.codes.min() >= 0
    assert out.codes.max() < quantizer.n_codes
    torch.testing.assert_close(quantizer.embed(out.codes), out.embeddings, atol=1e-5, rtol=1e-5)
    if isinstance(quantizer, Codebook):
        assert torch.equal(out.distances.argmin(1), out.codes)


@pytest.mark.parametrize("name", several())
def test_frozen_codes_do_not_move(name: str) -> None:
    """Not one number of them, statistics included, while what they stand for learns."""
    quantizer = several()[name].train()
    quantizer.freeze()
    before = copy.deepcopy(quantizer.state_dict())
    x = inputs(quantizer).requires_grad_()
    start = x.detach().clone()
    optimizer = torch.optim.Adam([x, *quantizer.parameters()], lr=0.1, weight_decay=0.1)

    for _ in range(PLACED_ANEW + 2):
        out = quantizer(x)
        (out.embeddings.square().sum() + out.commitment).backward()
        optimizer.step()
        optimizer.zero_grad()

    for key, value in quantizer.state_dict().items():
        assert torch.equal(value, before[key]), key
    assert not torch.equal(x, start)


@pytest.mark.parametrize("name", several())
def test_gradients_reach_the_input(name: str) -> None:
    quantizer = several()[name].train()
    x = inputs(quantizer).requires_grad_()

    quantizer(x).embeddings.square().sum().backward()

    assert (x.grad.abs().sum((1, 2)) > 0).all()


@given(st.lists(st.integers(1, 5), min_size=1, max_size=4), st.data())
def test_skill_codes_are_their_parts_in_mixed_radix(sizes: list[int], data: st.DataObject) -> None:
    quantizer = Continuous(WIDTH, None)
    quantizer.sizes = tuple(sizes)
    code = data.draw(st.integers(0, quantizer.n_codes - 1))

    parts = quantizer.split(torch.tensor([code]))

    assert all(0 <= part < size for part, size in zip(parts[0].tolist(), sizes, strict=True))
    assert quantizer.join(parts).tolist() == [code]


def test_continuous_skills_have_no_codes() -> None:
    x = torch.randn(5, 1, WIDTH)

    assert torch.equal(Continuous(WIDTH, None)(x).embeddings, x)
    assert Continuous(WIDTH, 4)(x).embeddings.shape == x.shape
    assert Continuous(WIDTH, 4).n_codes == 0
