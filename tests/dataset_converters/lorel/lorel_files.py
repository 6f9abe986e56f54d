"""Small files in the original layout, made on the spot."""

from pathlib import Path

import h5py
import numpy as np

LABELS = ("open drawer", "do nothing", "turn faucet left and move white mug down", "close drawer")


def original_arrays(episodes: int, frames: int = 20, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "state": rng.normal(size=(episodes, frames, 15)).astype(np.float32),
        "actions": rng.uniform(-1, 1, (episodes, frames, 5)).astype(np.float32),
        "ims": (rng.integers(0, 256, (episodes, frames, 64, 64, 3)) / 255).astype(np.float32),
    }


def write_original(folder: Path, arrays: dict[str, np.ndarray], labels: list[str] | None = None) -> tuple[Path, Path]:
    folder.mkdir(exist_ok=True)
    data, table = folder / "data.hdf5", folder / "labels.csv"
    with h5py.File(data, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(f"sim/{name}", data=values)
    count = len(arrays["state"]) if "state" in arrays else 3
    labels = [LABELS[i % 4] for i in range(count)] if labels is None else labels
    rows = "".join(f"{i},{label} \r\n" for i, label in enumerate(labels))
    table.write_text("Episode Number,Text Description\r\n" + rows, newline="")
    return data, table
