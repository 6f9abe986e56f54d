"""A causal transformer that can also remember: one code path for whole episodes and for step-by-step rollouts."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

EVERYTHING = 2**31
PREFIX = -1  # order of instruction tokens: below every observation's, so all of them are seen by everybody, always


def after_prefix(prefix_length: int, order: Tensor) -> Tensor:
    """Order of `[prefix ; tokens]`, (M + L,), for tokens of the given order (L,)."""
    return torch.cat([order.new_full((prefix_length,), PREFIX), order])


class Memory:
    """What a transformer has seen of a rollout: keys and values per block, and each token's order and validity.

    Buffers double when full, so that remembering a token costs amortised constant time. Tokens that have left the
    window are forgotten in bulk, so that a step costs the same however long the episode is.
    """

    def __init__(self, blocks: int, window: int | None) -> None:
        self.window = window
        self.order: Tensor | None = None  # (L,)
        self.valid: Tensor | None = None  # (B, L)
        self.length = 0
        self._keys_values: list[Tensor | None] = [None] * blocks  # each (2, B, heads, capacity, head width)

    def add_tokens(self, order: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Register new tokens, `order` (n,) and `valid` (B, n); return order (L,) and valid (B, L) of all tokens."""
        self._forget(int(order[0]))
        self.length += len(order)
        self.order = order if self.order is None else torch.cat([self.order, order])
        self.valid = valid if self.valid is None else torch.cat([self.valid, valid], dim=1)
        return self.order, self.valid

    def add_keys_values(self, block: int, keys_values: Tensor) -> Tensor:
        """Append (2, B, heads, n, d) to what `block` remembers; return all of it, (2, B, heads, L, d)."""
        start = self.length - keys_values.shape[3]
        buffer = self._keys_values[block]
        if buffer is None or buffer.shape[3] < self.length:
            grown = keys_values.new_empty(*keys_values.shape[:3], max(64, 2 * self.length), keys_values.shape[4])
            if buffer is not None:
                grown[..., :start, :] = buffer[..., :start, :]
            buffer = self._keys_values[block] = grown
        buffer[..., start : self.length, :] = keys_values
        return buffer[..., : self.length, :]

    def _forget(self, newest: int) -> None:
        """Drop what token `newest` cannot see, once that is half of everything."""
        if self.window is None or self.order is None or self.valid is None:
            return
        self._keep((self.order == PREFIX) | (self.order > newest - self.window))

    def begin_anew(self, who: Tensor) -> None:
        """Let some of the batch (B,) forget everything; drop what nobody remembers, once that is half of everything."""
        if self.order is None or self.valid is None:
            return
        self.valid = self.valid & ~who[:, None]
        self._keep(self.valid.any(0))

    def _keep(self, wanted: Tensor) -> None:
        """Drop tokens that are not wanted (L,), once they are half of all."""
        if self.order is None or self.valid is None or 2 * int(wanted.sum()) > self.length:
            return
        kept = wanted.nonzero()[:, 0]
        self.order, self.valid, self.length = self.order[kept], self.valid[:, kept], len(kept)
        self._keys_values = [None if buffer is None else buffer[..., kept, :] for buffer in self._keys_values]


class Block(nn.Module):
    """Pre-norm attention and MLP, each with a residual connection.

    Dropout acts on the residual branches, not on attention weights: that would force the unfused attention kernel,
    a quarter of a training step.
    """

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.attention_norm, self.mlp_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.query, self.key_value = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.output = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, mask: Tensor, rows: Tensor | None, memory: Memory | None, index: int) -> Tensor:
        """Attend from `rows` of x (all of them if None) to every token of x and of the memory.

        Args:
            x: New tokens (B, L, D).
            mask: Who may attend to whom, (B or 1, 1, rows, all tokens), True where allowed.
            rows: Positions (R,) in x whose outputs are wanted.
            memory: Earlier tokens' keys and values, extended in place.
            index: Which of the memory's blocks this is.

        Returns:
            (B, R, D).
        """
        normed = self.attention_norm(x)
        keys, values = self._keys_values(normed, memory, index)
        if rows is not None:
            x, normed = x[:, rows], normed[:, rows]
        query = self.query(normed).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        heads = F.scaled_dot_product_attention(query, keys, values, attn_mask=mask)
        x = x + self.dropout(self.output(heads.transpose(1, 2).flatten(2)))
        return x + self.dropout(self.mlp(self.mlp_norm(x)))

    def _keys_values(self, normed: Tensor, memory: Memory | None, index: int) -> Tensor:
        split = self.key_value(normed).unflatten(-1, (2, self.heads, -1))  # (B, L, 2, heads, d)
        keys_values = split.permute(2, 0, 3, 1, 4)
        return keys_values if memory is None else memory.add_keys_values(index, keys_values)


class CausalTransformer(nn.Module):
    """Blocks over tokens that carry an order: a token sees the valid tokens whose order is not above its own.

    Instruction tokens have order `PREFIX`: they see one another, and everybody sees them. Other tokens are seen only by
    those whose order is less than `window` above theirs.
    """

    def __init__(self, width: int, layers: int, heads: int, dropout: float, window: int | None = None) -> None:
        super().__init__()
        self.window = window
        self.blocks = nn.ModuleList(Block(width, heads, dropout) for _ in range(layers))
        self.input_norm, self.output_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.dropout = nn.Dropout(dropout)

    @property
    def reach(self) -> int:
        """How far below a token's order those can be that matter to it: each block looks back a window."""
        return EVERYTHING if self.window is None else len(self.blocks) * (self.window - 1)

    def new_memory(self) -> Memory:
        """An empty memory for one rollout."""
        return Memory(len(self.blocks), self.window)

    def forward(
        self,
        x: Tensor,
        order: Tensor,
        valid: Tensor | None = None,
        rows: Tensor | None = None,
        memory: Memory | None = None,
    ) -> Tensor:
        """Transform tokens.

        Args:
            x: Tokens (B, L, D).
            order: (L,) integers, the same for the whole batch.
            valid: (B, L), False for padding; None: all valid.
            rows: Positions (R,) whose outputs are wanted; the last block computes only these.
            memory: Tokens seen before these, extended by them.

        Returns:
            (B, R, D), or (B, L, D) without `rows`.
        """
        mask = self._mask(x, order, valid, memory)
        x = self.dropout(self.input_norm(x))
        for index, block in enumerate(self.blocks):
            wanted = rows if index == len(self.blocks) - 1 else None
            x = block(x, mask if wanted is None else mask[:, :, wanted], wanted, memory, index)
        return self.output_norm(x)

    def _mask(self, x: Tensor, order: Tensor, valid: Tensor | None, memory: Memory | None) -> Tensor:
        """(B or 1, 1, L, all tokens), True where a token may attend."""
        keys, keys_valid = order, valid
        if memory is not None:
            everything = torch.ones(x.shape[:2], dtype=torch.bool, device=x.device)
            keys, keys_valid = memory.add_tokens(order, everything if valid is None else valid)
        visible = keys[None, :] <= order[:, None]
        if self.window is not None:
            visible &= (keys[None, :] == PREFIX) | (keys[None, :] > order[:, None] - self.window)
        mask = visible[None, None]
        return mask if keys_valid is None else mask & keys_valid[:, None, None, :]
