"""What each of two processes does that train one codebook together."""

from pathlib import Path

import torch
import torch.distributed
from tiny_networks import WIDTH, codebook

from lerobot_lisa.networks.codebooks import Codebook

STEPS, RANKS = 30, 2


def batch(step: int, rank: int) -> torch.Tensor:
    """Embeddings of one rank, of another number each time, around centres that move apart."""
    random = torch.Generator().manual_seed(100 * step + rank)
    rows = 20 + 7 * ((step + rank) % 3)
    centres = torch.randn(8, WIDTH, generator=torch.Generator().manual_seed(0))
    return centres[torch.randint(8, (rows,), generator=random)] + 0.3 * torch.randn(rows, WIDTH, generator=random)


def run(rank: int, folder: Path, start: dict[str, torch.Tensor]) -> None:
    """Train as rank `rank` of two and write the states of every step.

    Once from the state `start` without reviving codes, and once from nothing, with k-means and codes that are revived.
    """
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=RANKS)
    torch.manual_seed(0)
    continued, fresh = codebook(dead_code_threshold=0), codebook(decay=0.5, dead_code_threshold=9)
    continued.load_state_dict(start)
    torch.manual_seed(rank)  # ranks draw different random numbers, as with lerobot-train
    states = {"continued": states_of(continued, rank), "fresh": states_of(fresh, rank)}
    torch.save(states, folder / f"{rank}.pt")
    torch.distributed.destroy_process_group()


def states_of(trained: Codebook, rank: int) -> list[dict[str, torch.Tensor]]:
    """Its state after each step."""
    states = []
    trained.train()
    for step in range(STEPS):
        trained(batch(step, rank)[:, None])
        states.append({key: value.clone() for key, value in trained.state_dict().items()})
    return states
