"""Sums up where a policy looks under each skill code, while it is being evaluated: over places and by things' names."""

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from math import isqrt, prod
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.configs import FeatureType, PolicyFeature
from numpy.typing import NDArray
from PIL import Image

from lerobot_lisa.analysis.files import aside
from lerobot_lisa.analysis.recording.environment import Looks, Moment
from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.lexicon import Symbols
from lerobot_lisa.policies.parts import named_symbols

LOOKS_FILE = "looks.parquet"
NO_CODE = -1
_BATCH = ["group", "task_id", "first"]
_SCHEMA = pa.schema(
    {
        "group": pa.string(),
        "task_id": pa.int32(),
        "first": pa.int32(),
        "code": pa.int32(),
        "feature": pa.string(),
        "rows": pa.int32(),
        "columns": pa.int32(),
        "steps": pa.int64(),
        "questions": pa.int64(),
        "attention": pa.list_(pa.float64()),
        "names": pa.list_(pa.string()),
        "named": pa.list_(pa.float64()),
        "in_view": pa.list_(pa.int64()),
        "lot": pa.uint64(),
        "picture": pa.binary(),
    }
)
_MOST_PIXELS = 128  # along the longer side of a picture that is kept


@dataclass(frozen=True)
class Look:
    """Where a skill looks in one feature, summed over all steps that followed it.

    Attributes:
        code: Skill code; None for a policy without.
        feature: Such as `observation.grid`.
        steps: How many.
        questions: How many were asked in them; each has an attention of 1, for places of all features or for nothing.
        attention: Summed, as the feature is seen from above or in front, (rows, columns).
        named: Summed by what things are called, or under the feature's own name where they are called nothing.
        in_view: In how many steps something so called was there to be looked at.
        picture: One that was seen under the code, (height, width, 3); None if the feature shows none.
    """

    code: int | None
    feature: str
    steps: int
    questions: int
    attention: NDArray[np.float64]
    named: Mapping[str, float]
    in_view: Mapping[str, int]
    picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class _View:
    """How a feature is seen.

    Attributes:
        key: Of the feature.
        feature: What it holds.
        symbols: What its symbols are called; None: nothing.
    """

    key: str
    feature: PolicyFeature
    symbols: Symbols | None

    @cached_property
    def names(self) -> list[str]:
        """What things may be called, adjectives first; one name if it says nothing else."""
        if self.symbols is None:
            return [self.key.removeprefix("observation.")]
        words = np.array([""], dtype=object)
        for channel in self._naming:  # what is there at all comes first, and last in English
            more = np.array(self.symbols["channels"][channel]["words"], dtype=object)
            words = (more[None, :] + " " + words[:, None]).ravel()
        return [" ".join(name.split()) for name in words]

    @property
    def _naming(self) -> list[int]:
        assert self.symbols is not None  # asked for symbols only
        listed = [channel["name"] for channel in self.symbols["channels"]]
        return [listed.index(name) for name in self.symbols.get("naming", listed)]

    def name_numbers(self, shown: NDArray[Any] | None, places: int) -> NDArray[np.int64] | None:
        """Which name each place has, (n, places); None if that cannot be seen."""
        if self.symbols is None:
            return np.zeros((1, places), np.int64)
        if shown is None:
            return None
        cells = shown.reshape(len(shown), places, -1).astype(np.int64)
        sizes = [len(self.symbols["channels"][channel]["words"]) for channel in self._naming]
        values = [cells[..., c].clip(0, size - 1) for c, size in zip(self._naming, sizes, strict=True)]
        return np.ravel_multi_index(values, sizes)

    def arrange(self, attention: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places in their order to rows and columns as they are seen."""
        if self.symbols is not None:
            grid = attention.reshape(prod(self.symbols["shape"][:-2]), -1)
            return grid.T if self.symbols.get("axes", [""])[0] == "column" else grid
        side = isqrt(attention.size)
        square = self.feature.type is FeatureType.VISUAL and side * side == attention.size
        return attention.reshape((side, side) if square else (1, -1))


@dataclass
class _Sums:
    """Of one code and feature in the current batch."""

    attention: NDArray[np.float64]
    named: NDArray[np.float64]
    in_view: NDArray[np.int64]
    steps: int = 0
    questions: int = 0
    lot: int = 2**64 - 1
    picture: bytes | None = None


@dataclass
class LooksCollector:
    """Watches a recording. The sums depend neither on the order of batches nor on interruptions.

    Each batch has rows of its own, so that one that was interrupted after they were written replaces them.

    Attributes:
        folder: For `LOOKS_FILE`; what is there is gone on with.
        config: Of the policy.
    """

    folder: Path
    config: EpisodePolicyConfig
    _sums: dict[tuple[int, str], _Sums] = field(default_factory=dict)

    @cached_property
    def _views(self) -> dict[str, _View]:
        symbols = named_symbols(self.config)
        return {key: _View(key, value, symbols[key]) for key, value in (self.config.input_features or {}).items()}

    def before_step(self, moment: Moment) -> None:
        """Add where the policy looked in every environment that counts."""
        if moment.step == 0:
            self._sums.clear()
        if moment.looks is None:
            return
        live = np.array(moment.live, np.int64)
        codes = np.full(len(live), NO_CODE) if moment.codes is None else moment.codes[live]
        for code in np.unique(codes):
            for key in moment.looks.attention:
                self._add(moment, moment.looks, live[codes == code], int(code), self._views[key])

    def after_rollout(self, moment: Moment) -> None:
        """Write what the batch has added."""
        path, batch = self.folder / LOOKS_FILE, dict(zip(_BATCH, moment.batch, strict=True))
        others = [row for row in _read(path) if any(row[name] != value for name, value in batch.items())]
        rows = others + [{**batch, **self._row(*place, sums)} for place, sums in sorted(self._sums.items())]
        _keep_first_pictures(rows)
        with aside(path) as partial:
            pq.write_table(pa.Table.from_pylist(rows, _SCHEMA), partial, compression="zstd")
        self._sums.clear()

    def _add(self, moment: Moment, looks: Looks, chosen: NDArray[np.int64], code: int, view: _View) -> None:
        attention = looks.attention[view.key][chosen].astype(np.float64)  # (n, places)
        places, names = attention.shape[1], len(view.names)
        empty = (np.zeros(places), np.zeros(names), np.zeros(names, np.int64))
        sums = self._sums.setdefault((code, view.key), _Sums(*empty))
        sums.steps += len(chosen)
        sums.questions += int(looks.questions[chosen].sum())
        sums.attention += attention.sum(0)
        shown = _shown(moment.observation, view.key)
        if (numbers := view.name_numbers(None if shown is None else shown[chosen], places)) is not None:
            numbers = np.broadcast_to(numbers, attention.shape)
            sums.named += np.bincount(numbers.ravel(), attention.ravel(), names)
            there = np.zeros((len(chosen), names), bool)
            np.put_along_axis(there, numbers, True, axis=1)
            sums.in_view += there.sum(0)
        if view.feature.type is FeatureType.VISUAL and shown is not None:
            self._keep_picture(moment, sums, chosen, shown)

    def _keep_picture(self, moment: Moment, sums: _Sums, chosen: NDArray[np.int64], shown: NDArray[np.uint8]) -> None:
        """Of all pictures seen under a code the one with the smallest lot, a hash of episode and step."""
        for index in chosen.tolist():
            place = (*moment.batch[:2], moment.batch.first + index, moment.step)
            lot = int.from_bytes(blake2b(repr(place).encode(), digest_size=8).digest(), "little")
            if lot < sums.lot:
                sums.lot, sums.picture = lot, _png(shown[index])

    def _row(self, code: int, key: str, sums: _Sums) -> dict[str, Any]:
        view = self._views[key]
        arranged = view.arrange(sums.attention)
        there = np.flatnonzero((sums.in_view > 0) | (sums.named > 0))
        return {
            "code": code, "feature": key, "rows": arranged.shape[0], "columns": arranged.shape[1],
            "steps": sums.steps, "questions": sums.questions, "attention": arranged.ravel().tolist(),
            "names": [view.names[number] for number in there], "named": sums.named[there].tolist(),
            "in_view": sums.in_view[there].tolist(), "lot": sums.lot, "picture": sums.picture,
        }  # fmt: skip


def read(folder: Path) -> list[Look]:
    """What was collected in a folder, by code and feature; nothing if nothing was.

    Raises:
        UserError: The file is another.
    """
    groups: dict[tuple[int, str], list[dict[str, Any]]] = {}
    for row in sorted(_read(folder / LOOKS_FILE), key=lambda row: [row[name] for name in _BATCH]):
        groups.setdefault((row["code"], row["feature"]), []).append(row)
    return [_join(rows) for _, rows in sorted(groups.items())]


def _join(rows: Sequence[Mapping[str, Any]]) -> Look:
    """The rows of all batches for one code and feature as one."""
    first, named, in_view = rows[0], dict[str, float](), dict[str, int]()
    for row in rows:
        for name, attention, times in zip(row["names"], row["named"], row["in_view"], strict=True):
            named[name] = named.get(name, 0.0) + attention
            in_view[name] = in_view.get(name, 0) + times
    attention = np.sum([row["attention"] for row in rows], axis=0).reshape(first["rows"], first["columns"])
    pictures = [row["picture"] for row in rows if row["picture"] is not None]
    return Look(
        None if first["code"] == NO_CODE else first["code"],
        first["feature"],
        sum(row["steps"] for row in rows),
        sum(row["questions"] for row in rows),
        attention,
        named,
        in_view,
        np.asarray(Image.open(io.BytesIO(pictures[0])).convert("RGB")) if pictures else None,
    )


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    try:
        return pq.read_table(path).cast(_SCHEMA).to_pylist()
    except (OSError, ValueError, pa.ArrowException) as error:
        raise UserError(f"{path}: not looks of lerobot_lisa ({str(error).splitlines()[0]}): delete it") from error


def _keep_first_pictures(rows: Iterable[dict[str, Any]]) -> None:
    """One picture of each code and feature is enough: that with the smallest lot."""
    best: dict[tuple[int, str], dict[str, Any]] = {}
    for row in rows:
        kept = best.setdefault((row["code"], row["feature"]), row)
        if row["lot"] < kept["lot"]:
            best[row["code"], row["feature"]] = row
            kept["picture"] = None
        elif row is not kept:
            row["picture"] = None


def _shown(observation: Any, key: str) -> NDArray[Any] | None:
    """What LeRobot makes the feature `key` of, (B, ...); None where an environment calls it otherwise."""
    if not isinstance(observation, Mapping):
        return None
    name = key.removeprefix("observation.")
    pictures = observation.get("pixels")
    if name.startswith("images.") and isinstance(pictures, Mapping):
        return pictures.get(name.removeprefix("images."))
    return pictures if name == "image" and not isinstance(pictures, Mapping) else observation.get(name)


def _png(picture: NDArray[np.uint8]) -> bytes:
    file, image = io.BytesIO(), Image.fromarray(picture)
    image.thumbnail((_MOST_PIXELS, _MOST_PIXELS))
    image.save(file, "png")
    return file.getvalue()
