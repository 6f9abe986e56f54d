"""What was measured before rows had files, with what is known about it: `docs/results/before/<world>.json`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lerobot_lisa.reproduce.outcomes import Outcome


def read_before(world: str, folder: Path) -> list[Outcome]:
    """Runs as `side_by_side` shows them: their `row` says when and with what, their `link` where that is told.

    A group of runs names what each policy's seeds did: counts, or the name of counts for each task in a `counts` file.

    Args:
        world: The file.
        folder: docs/results.
    """
    path = folder / "before" / f"{world}.json"
    return list(_runs(json.loads(path.read_text(encoding="utf-8")), folder.parent)) if path.is_file() else []


def _runs(groups: list[dict[str, Any]], docs: Path) -> Iterator[Outcome]:
    for group in groups:
        title = f"{group['row']}: {group['when']}"
        shown = {"commit": group.get("commit", "counts"), "link": group.get("counts") or group["told"]}
        for policy, seeds in group["runs"].items():
            for seed in seeds:
                rates = seed if isinstance(seed, dict) else {"success": _counted(docs / group["counts"], seed)}
                yield {"row": title, "like": group["like"], "policy": policy, "rates": rates, **shown}


def _counted(path: Path, name: str) -> dict[str, int]:
    tasks = json.loads(path.read_text(encoding="utf-8"))[name].values()
    successes, episodes = map(sum, zip(*tasks, strict=True))
    return {"successes": successes, "episodes": episodes}
