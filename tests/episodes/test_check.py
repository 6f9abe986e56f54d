"""Datasets whose files do not keep what their metadata promise are refused in one line, and never trained on."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_lisa.episodes.check import check_metadata
from lerobot_lisa.episodes.load import load_episodes
from lerobot_lisa.errors import UserError

KEYS = ["observation.grid", "action"]
Change = Callable[[Path], object]


def load(root: Path, keys: list[str] = KEYS) -> None:
    load_episodes(LeRobotDatasetMetadata("local/tiny", root=root), keys)


def rows(change: Callable[[pa.Table], pa.Table]) -> Change:
    """Write the only data file anew."""

    def write(root: Path) -> None:
        (path,) = root.rglob("data/**/*.parquet")
        pq.write_table(change(pq.read_table(path)), path)

    return write


def episodes(change: Callable[[pd.DataFrame], object]) -> Change:
    """Change meta/episodes."""

    def write(root: Path) -> None:
        (path,) = root.rglob("meta/episodes/**/*.parquet")
        frame = pd.read_parquet(path)
        change(frame)
        frame.to_parquet(path)

    return write


def tasks(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Change:
    """Change the instructions."""

    def write(root: Path) -> None:
        path = root / "meta/tasks.parquet"
        change(pd.read_parquet(path)).to_parquet(path)

    return write


def edited(name: str, change: Callable[[Any], object]) -> Change:
    """Change a JSON file of meta."""

    def write(root: Path) -> None:
        document = json.loads((root / "meta" / name).read_text())
        change(document)
        (root / "meta" / name).write_text(json.dumps(document))

    return write


def column(name: str, change: Callable[[np.ndarray], object]) -> Callable[[pa.Table], pa.Table]:
    """Change a column of numbers."""

    def write(table: pa.Table) -> pa.Table:
        values = table.column(name).to_numpy().copy()
        change(values)
        return table.set_column(table.schema.get_field_index(name), name, pa.array(values))

    return write


def set_item(where: Any, value: Any) -> Callable[[Any], None]:
    def change(values: Any) -> None:
        values[where] = value

    return change


LIES: dict[str, tuple[Change, str]] = {
    "overlapping ranges": (
        episodes(lambda d: d.__setitem__("dataset_from_index", 0)),
        r"gives episode 1 the frames from 0 up to 8, but it must begin at 7",
    ),
    "a range beyond the frames": (
        episodes(lambda d: d.__setitem__("dataset_to_index", d["dataset_to_index"] + 10_000)),
        "gives episode 1 the frames from 7 up to 10008",
    ),
    "a negative range": (
        episodes(lambda d: d.__setitem__("dataset_from_index", -5)),
        "gives episode 0 the frames from -5",
    ),
    "an empty episode": (
        episodes(lambda d: d.loc.__setitem__((1, "dataset_to_index"), 7)),
        "gives episode 1 the frames from 7 up to 7, but it must begin at 7 and have some",
    ),
    "more frames counted": (
        edited("info.json", set_item("total_frames", 10**12)),
        "its 6 episodes have 56 frames, but meta/info.json counts 1000000000000",
    ),
    "rows twice in place of others": (
        rows(lambda t: pa.concat_tables([t.slice(0, 53), t.slice(0, 3)])),
        r"frame 0 \(episode 0\) is there twice",
    ),
    "rows of another order, one of them twice": (
        rows(lambda t: pa.concat_tables([t.slice(30, 26), t.slice(0, 29), t.slice(50, 1)])),
        r"frame 50 \(episode 4\) is there twice",
    ),
    "rows missing": (
        rows(lambda t: t.slice(0, 53)),
        r"frame 53 \(episode 5\) is one of 3 that no data file holds",
    ),
    "rows beyond the dataset": (rows(column("index", set_item(3, 99))), "hold frame 99, but the dataset has 56 frames"),
    "another episode's rows": (
        rows(column("episode_index", set_item(9, 5))),
        r"frame 9 \(episode 2\) says in its row that it is another episode's",
    ),
    "symbols beyond the statistics": (
        edited("stats.json", lambda stats: stats["observation.grid"].update(max=[1] * 147)),
        r"frame 0 \(episode 0\) holds \d+ in `observation.grid`, but meta/stats.json promises 0 to 1: run lerobot-edit",
    ),
    "actions beyond the statistics": (
        rows(column("action", set_item(8, 9))),
        r"frame 8 \(episode 2\) holds 9 in `action`, but meta/stats.json promises 0 to 6",
    ),
    "another shape": (
        edited("info.json", lambda info: info["features"]["observation.grid"].update(shape=[148])),
        "`observation.grid` does not hold 148 numbers in each row",
    ),
    "a value missing": (
        rows(lambda table: nulled(table)),
        "`action` does not hold 1 numbers in each row",
    ),
    "a column missing": (rows(lambda t: t.drop_columns("action")), "the file has no column `action`"),
    "half a file": (lambda root: halve(*root.rglob("data/**/*.parquet")), "this is no readable parquet file"),
    "a path out of the dataset": (
        edited("info.json", set_item("data_path", "../tiny/data/file-{file_index:03d}.parquet")),
        "data_path is no place in the dataset",
    ),
    "a path that is none": (
        edited("info.json", set_item("data_path", "data/{chunk_index.__class__.__mro__}/{file}")),
        "data_path is no place in the dataset",
    ),
    "fewer instructions": (
        tasks(lambda d: d.iloc[:2]),
        "meta/tasks.parquet holds 2 instructions, but meta/info.json counts 5",
    ),
    "instructions that are no text": (
        tasks(lambda d: d.set_axis(range(len(d)))),
        "meta/tasks.parquet holds 0 instructions, but meta/info.json counts 5",
    ),
}


def nulled(table: pa.Table) -> pa.Table:
    values = [None, *table.column("action").to_pylist()[1:]]
    return table.set_column(table.schema.get_field_index("action"), "action", pa.array(values, pa.int64()))


def halve(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize("lie", LIES)
def test_lies_are_refused(lie: str, symbolic: Path, tmp_path: Path) -> None:
    change, message = LIES[lie]
    root = Path(shutil.copytree(symbolic, tmp_path / "data"))
    change(root)
    with pytest.raises(UserError, match=message) as refused:
        load(root)
    assert str(root) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("key", ["observation.state", "action"])
def test_what_is_not_finite_names_feature_and_episode(key: str, bad: float, continuous: Path, tmp_path: Path) -> None:
    """1e30 is, but its square is not. What LeRobot's recorder makes of such numbers: its statistics say so, too."""
    root = Path(shutil.copytree(continuous, tmp_path / "data"))
    rows(in_row(20, key, bad))(root)
    with pytest.raises(UserError, match=rf"frame 20 \(episode 3\) holds .* in `{key}`, which cannot be learned from"):
        load(root, [key])
    if not np.isfinite(bad):
        edited("stats.json", lambda stats: stats[key]["mean"].__setitem__(0, bad))(root)
        with pytest.raises(UserError, match=rf"`{key}` is not finite \(meta/stats.json, mean\)"):
            load(root, [key])
        episodes(lambda d: d.__setitem__(f"stats/{key}/mean", [[bad if i == 3 else 0] for i in range(6)]))(root)
        with pytest.raises(UserError, match=rf"`{key}` is not finite in episode 3 \(meta/stats.json, mean\)"):
            check_metadata(LeRobotDatasetMetadata("local/tiny", root=root), [key])


def in_row(row: int, key: str, value: float) -> Callable[[pa.Table], pa.Table]:
    def write(table: pa.Table) -> pa.Table:
        values = np.stack(table.column(key).to_pylist())
        values[row, 1] = value
        kind = table.schema.field(key).type
        return table.set_column(table.schema.get_field_index(key), key, pa.array(values.tolist(), kind))

    return write


def test_rows_may_come_in_any_order(symbolic: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(symbolic, tmp_path / "data"))
    order = np.random.default_rng(0).permutation(56)
    rows(lambda table: table.take(order))(root)
    shuffled, plain = (load_episodes(LeRobotDatasetMetadata("local/tiny", root=r), KEYS) for r in (root, symbolic))
    assert all((shuffled.columns[key] == plain.columns[key]).all() for key in KEYS)
