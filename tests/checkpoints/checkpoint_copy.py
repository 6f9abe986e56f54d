"""A checkpoint of a test's own, to be changed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from safetensors.torch import load_file, save_file


class Copy:
    """A checkpoint of the test's own."""

    def __init__(self, original: Path, folder: Path) -> None:
        self.folder = Path(shutil.copytree(original, folder))

    def edit(self, name: str, change: Callable[[Any], object]) -> None:
        """Change the content of a JSON file in place."""
        path = self.folder / name
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    def edit_tensors(self, pattern: str, change: Callable[[dict[str, Any]], object]) -> None:
        """Change the tensors of a file in place."""
        (path,) = self.folder.glob(pattern)
        tensors = load_file(path)
        change(tensors)
        save_file(tensors, path)
