"""The wheel holds what it should, and LeRobot finds the plugin that is installed from it without any flag."""

import json
import os
import site
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FIND_PLUGINS = """
import json, sys
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins
register_third_party_plugins()
import lerobot_lisa
known = [*PreTrainedConfig.get_known_choices(), *EnvConfig.get_known_choices()]
print(json.dumps([lerobot_lisa.__file__, known]))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_contents(names: set[str]) -> None:
    info = next(name.split("/")[0] for name in names if ".dist-info/" in name)
    assert {name.split("/")[0] for name in names} == {
        "lerobot_lisa", "dataset_converters", "lerobot_policy_lisa.py", info,
    }  # fmt: skip
    assert {"lerobot_lisa/policies/model_card.md", f"{info}/licenses/LICENSE", f"{info}/licenses/NOTICE"} <= names


def test_every_module_every_recipe_and_what_they_read_is_in_it(names: set[str]) -> None:
    packaged = [*ROOT.glob("lerobot_lisa/**/*"), *ROOT.glob("dataset_converters/**/*")]
    files = [path for path in packaged if path.is_file() and "__pycache__" not in path.parts]
    assert {path.suffix for path in files} >= {".py", ".xml", ".json", ".md"}
    assert {path.relative_to(ROOT).as_posix() for path in files} <= names
    recipes = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("configs/**/*.yaml")}
    assert {f"lerobot_lisa/{recipe}" for recipe in recipes} <= names
    assert "configs/quickstart/lisa.yaml" in recipes


def test_the_name_keeps_its_underscores(wheel: Path) -> None:
    """LeRobot looks for distributions by their raw name and imports a module of that name."""
    with zipfile.ZipFile(wheel) as archive:
        path = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = Parser().parsestr(archive.read(path).decode())
    assert metadata["Name"] == "lerobot_policy_lisa"


def test_lerobot_finds_the_installed_plugin(wheel: Path, tmp_path: Path) -> None:
    """In a fresh environment that borrows this one's libraries, but not its editable install."""
    venv.create(tmp_path / "venv", with_pip=False)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(tmp_path / "venv")}))
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(packages), str(wheel)]
    subprocess.run(install, check=True)
    borrowed = [path for path in map(Path, site.getsitepackages()) if path.is_dir()]
    (packages / "borrowed.pth").write_text("".join(f"{path}\n" for path in borrowed))  # paths only: no .pth of theirs

    python = tmp_path / "venv" / "bin" / "python"
    env = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [python, "-c", FIND_PLUGINS], capture_output=True, text=True, check=False, cwd=tmp_path, env=env
    )

    assert done.returncode == 0, done.stderr
    imported, known = json.loads(done.stdout.splitlines()[-1])
    assert Path(imported).is_relative_to(packages)
    assert {"lisa", "lang_dt", "babyai"} <= set(known)
