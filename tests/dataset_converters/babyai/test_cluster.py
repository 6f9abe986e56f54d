"""Datasets made in shards hold the same bytes as those made at once, however they were interrupted."""

import os
import re
from pathlib import Path

import dill
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from original_files import demo, dump

from dataset_converters.babyai import generate as generate_module
from dataset_converters.babyai.convert import ConvertSettings, convert
from dataset_converters.babyai.generate import GenerateSettings, generate
from dataset_converters.cluster.cli import main

EPISODES = ["episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index", "level", "seed"]
OPTIONS = ["--repo-id", "me/local", "--workers", "1"]
GENERATE = ["generate", "--level", "GoToLocal", "--episodes", "60", "--per-shard", "25", *OPTIONS]


def table(root: Path, part: str, columns: list[str] | None = None) -> pa.Table:
    files = sorted((root / part).rglob("*.parquet"))
    return pa.concat_tables([pq.read_table(file, columns=columns).replace_schema_metadata() for file in files])


def assert_same(root: Path, expected: Path) -> None:
    """Data columns equal to the byte, episodes and instructions too; LeRobot loads it."""
    assert table(root, "data").equals(table(expected, "data").cast(table(root, "data").schema))
    assert table(root, "data").schema.names == table(expected, "data").schema.names
    assert table(root, "meta/episodes", EPISODES).to_pylist() == table(expected, "meta/episodes", EPISODES).to_pylist()
    merged, single = (LeRobotDataset("me/local", root=path) for path in (root, expected))
    assert merged.meta.tasks.equals(single.meta.tasks)
    assert merged.hf_dataset.features == single.hf_dataset.features
    assert len(merged) == len(single)
    assert not root.with_name(root.name + ".shards").exists()


def fails(seed: int) -> bool:
    return seed % 3 == 0


@pytest.fixture
def some_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bot that fails at every third seed."""
    from dataset_converters.babyai import shards

    demonstrate = shards.demonstrate
    monkeypatch.setattr(
        shards, "demonstrate", lambda level, name, seed: None if fails(seed) else demonstrate(level, name, seed)
    )


@pytest.fixture
def single(tmp_path: Path, some_fail: None) -> Path:
    generate(GenerateSettings("GoToLocal", 60, tmp_path / "single", "me/local"))
    return tmp_path / "single"


def test_generated_shards_merge_to_the_same_bytes(single: Path, tmp_path: Path) -> None:
    assert main([*GENERATE, "--root", str(tmp_path / "merged")]) == 0

    assert_same(tmp_path / "merged", single)
    facts = re.findall(r"\*\*Seeds:\*\*.*", (tmp_path / "merged/README.md").read_text())
    assert facts == re.findall(r"\*\*Seeds:\*\*.*", (single / "README.md").read_text())


def test_an_interrupted_run_goes_on(single: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root, made = tmp_path / "merged", []
    make_shard = generate_module.make_shard

    def interrupted(*arguments: object) -> object:
        if len(made) == 1:
            raise KeyboardInterrupt
        made.append(arguments)
        return make_shard(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(generate_module, "make_shard", interrupted)
        assert main([*GENERATE, "--root", str(root)]) == 130
    first = tmp_path / "merged.shards/00000"
    assert (first / "meta/info.json").is_file()
    written = (first / "meta/info.json").stat().st_mtime_ns
    assert not root.exists()
    assert main([*GENERATE, "--root", str(root), "--per-shard", "30"]) == 1  # other shards would not fit

    with monkeypatch.context() as patch:
        patch.setattr(
            generate_module, "write_dataset", _refuse_rewriting(generate_module.write_dataset, first, written)
        )
        assert main([*GENERATE, "--root", str(root)]) == 0

    assert_same(root, single)
    assert main([*GENERATE, "--root", str(root)]) == 1


def _refuse_rewriting(write, first: Path, written: int):
    def checked(root: Path, *arguments: object):
        assert (first / "meta/info.json").stat().st_mtime_ns == written
        assert root.parent.name != "00000.partial"
        return write(root, *arguments)

    return checked


def test_converted_files_merge_to_the_same_bytes(tmp_path: Path) -> None:
    demos = [demo(2 + i % 5, seed=i, mission=f"go to ball {i % 7}") for i in range(20)]
    whole, parts = tmp_path / "BabyAI-GoToSeq-v0.pkl", [tmp_path / "first.pkl", tmp_path / "second.pkl"]
    for path, part in zip([whole, *parts], [demos, demos[:8], demos[8:]], strict=True):
        path.write_bytes(dump(part))
    convert(ConvertSettings(whole, tmp_path / "single", "me/local"))

    sources = [str(part) for part in parts]
    assert main(["convert", *sources, "--level", "GoToSeq", *OPTIONS, "--root", str(tmp_path / "merged")]) == 0

    assert_same(tmp_path / "merged", tmp_path / "single")
    assert "first.pkl, second.pkl" in (tmp_path / "merged/README.md").read_text()


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """SLURM's commands: `sbatch` keeps what it gets and gives it a number, `scontrol` knows one machine."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    commands = {
        "sbatch": 'number=$(ls "$(dirname "$0")" | grep -c txt); script="${@: -1}"\n'
        'printf "%s\\n" "${@:1:$#-1}" | cat - "$script" > "$(dirname "$0")/$number.txt"; echo "Submitted job $number"',
        "scontrol": "echo localhost",
    }
    for name, command in commands.items():
        (folder / name).write_text(f"#!/usr/bin/env bash\n{command}\n")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    return folder


def test_slurm_jobs_make_the_same_bytes(
    slurm: Path, single: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "merged"
    options = ["--executor", "slurm", "--partition", "cpu", "--workers", "2", "--root", str(root)]
    assert main([*GENERATE, *options]) == 0

    jobs = [(slurm / f"{number}.txt").read_text() for number in range(4)]  # each is followed by one for its statistics
    assert "#SBATCH --array=0-2%2" in jobs[0]
    assert "#SBATCH --partition=cpu" in jobs[0]
    assert "--dependency=afterok:0" in jobs[2]
    monkeypatch.setenv("SLURM_NODELIST", "localhost")
    for job, ranks in ((jobs[0], range(3)), (jobs[2], range(1))):
        (executor,) = re.findall(r"launch_pickled_pipeline (\S+)", job)
        for rank in ranks:
            monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(rank))
            with open(executor, "rb") as file:  # noqa: PTH123  what launch_pickled_pipeline does
                dill.load(file).run()

    logs = root.with_name("merged.shards")
    assert [path.name for path in logs.iterdir()] == ["logs"]
    logs.rename(tmp_path / "logs")
    assert_same(root, single)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--executor", "slurm"], "needs --partition"),
        (["--per-shard", "0"], "--per-shard must be at least 1"),
        (["--first-seed", "5"], "reserved"),
    ],
)
def test_mistakes_are_one_line(options: list[str], message: str, tmp_path: Path, capsys) -> None:
    assert main([*GENERATE, "--root", str(tmp_path / "merged"), *options]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert list(tmp_path.iterdir()) == []
