"""What has to run for a row: its dataset, a training and an evaluation for each policy and seed."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from lerobot_lisa.code_version import fingerprint
from lerobot_lisa.errors import UserError
from lerobot_lisa.reproduce import speeds
from lerobot_lisa.reproduce.recipes import as_words, in_use, read_recipe, what_decides, with_options
from lerobot_lisa.reproduce.rows import DATA_ONLY, Row, find_configs
from lerobot_lisa.reproduce.steps import Step

HEARD = "lisa-diagnose heard"
PROGRAMS = {
    HEARD: ("lerobot_lisa.analysis.listening.heard", "heard.json"),
    "lisa-diagnose rephrase": ("lerobot_lisa.analysis.listening.rephrase", "rephrase.csv"),
    "lisa-report": ("lerobot_lisa.analysis.report.build", "report.html"),
    "lisa-unseen": ("lerobot_lisa.analysis.unseen", "unseen.json"),
}
"""What evaluates: the module that it depends on, and the file that it writes last."""
_SIMULATORS = {"babyai": ("minigrid",), "lorel": ("mujoco",), "metaworld": ("mujoco", "metaworld")}


@dataclass(frozen=True)
class Settings:
    """What holds for all rows of a command.

    Attributes:
        rows: All rows by their names.
        root: Folder of all that is made.
        device: Where networks run; empty: LeRobot chooses.
        also: Recipes of the user's own, by the names of their columns: trained and evaluated as a row's policies are.
    """

    rows: Mapping[str, Row]
    root: Path
    device: str = ""
    also: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """One number of a row: a policy and a seed.

    Attributes:
        row: Whose.
        policy: Its name in the row; "lisa@500" after 500 steps of its training.
        seed: Of the training.
        step: The evaluation; None: there is no recipe for the policy.
    """

    row: Row
    policy: str
    seed: int
    step: Step | None

    @property
    def kind(self) -> str:
        """The policy, whenever it is evaluated."""
        return self.policy.partition("@")[0]

    @property
    def steps(self) -> list[Step]:
        """All of them in order."""
        return list({step.name: step for step in self.step.chain()}.values()) if self.step else []


def plan(rows: Iterable[Row], settings: Settings, seeds: Sequence[int] | None = None) -> list[Run]:
    """All runs of rows.

    Args:
        rows: Which.
        settings: Of the command.
        seeds: Of the trainings; None: those that the rows name.
    """
    runs = []
    for row in rows:
        only_data = row.policies == (DATA_ONLY,)
        for policy in (*row.policies, *({} if only_data else settings.also)):
            for seed in (0,) if only_data else (seeds or row.seeds):
                for name in (*(f"{policy}@{steps}" for steps in row.curve), policy):
                    runs.append(Run(row, name, seed, evaluation(row, name, seed, settings)))
    return runs


def evaluation(row: Row, policy: str, seed: int, settings: Settings) -> Step | None:
    """The last step of a run; None: there is no recipe for its policy."""
    kind, _, at = policy.partition("@")
    before = data(row, settings) if kind == DATA_ONLY else training(row, kind, seed, settings)
    if before is None:
        return None
    evaluate = row.evaluation(kind)
    program = evaluate.get("program", HEARD)
    module, result = PROGRAMS[program]
    options = {key: value for key, value in evaluate.items() if key not in ("program", "tasks")}
    if kind == DATA_ONLY:
        taken = {"dataset.root": before.folder / "data", **options, "json": f"{{folder}}/{result}"}
    else:
        taken = {"policy.path": checkpoint(before, at), **_device(settings), **options, "output_dir": "{folder}"}
    name, world = program.split()[-1].removeprefix("lisa-"), f"lerobot_lisa.envs.{options.get('env.type', 'babyai')}"
    code = fingerprint([module, f"{world}.env", f"{world}.config"], in_use(before.depends.get("config", {})))
    return Step(
        kind=name,
        label=_label(row, policy, seed),
        parent=settings.root / name,
        depends={
            "program": program,
            "options": options,
            "of": before.depends,
            "code": code,
            **({"at": at} if at else {}),
        },
        template=(*program.split(), *as_words(taken)),
        result=result,
        after=(before,),
        seconds=_seconds_of_evaluation(row, kind, evaluate),
    )


def _seconds_of_evaluation(row: Row, policy: str, evaluate: Mapping[str, Any]) -> float:
    episodes = int(evaluate.get("n_episodes", evaluate.get("n", 100))) * int(evaluate.get("tasks", 1))
    if row.policies == (DATA_ONLY,):
        return speeds.SECONDS_TO_START + episodes * speeds.SECONDS_FOR_A_MISSION
    return speeds.seconds_of_evaluation(row.world, policy, episodes)


def training(row: Row, policy: str, seed: int, settings: Settings) -> Step | None:
    """Train a policy of a row; None: there is no recipe for it."""
    path = settings.also.get(policy) or _short(find_configs() / row.recipes / f"{policy}.yaml")
    if not path.is_file():
        return None
    options = row.differences(policy)
    whole = {**with_options(read_recipe(path), options), "seed": seed}
    demonstrations, start = data(row, settings), _start(row, policy, seed, settings)
    given = {"dataset.repo_id": _repo_id(row), "dataset.root": demonstrations.folder / "data", "seed": seed}
    given |= {"policy.path": checkpoint(start)} if start else {}
    words = as_words({**given, **_device(settings), **options, "output_dir": "{folder}/run"})
    steps = int(whole["steps"])
    return Step(
        kind="train",
        label=_label(row, policy, seed),
        parent=settings.root / "train",
        depends=_what_training_depends_on(whole, policy, demonstrations, start),
        template=("lerobot-train", f"--config_path={path}", *words),
        result=f"run/checkpoints/{_checkpoint_name(steps)}/training_state/scheduler_state.json",
        after=(demonstrations, start) if start else (demonstrations,),
        seconds=speeds.seconds_of_training(row.world, policy, steps, int(whole.get("batch_size", 8))),
        going_on="run/checkpoints/last/pretrained_model/train_config.json",
    )


def _what_training_depends_on(
    whole: Mapping[str, Any], policy: str, demonstrations: Step, start: Step | None
) -> dict[str, Any]:
    kind = str(whole.get("policy", {}).get("type", policy))
    module = (
        f"lerobot_lisa.policies.{kind}"  # somebody else's policy has none here: then LeRobot's version stands for it
    )
    config = what_decides(whole)
    return {
        "config": config,
        "data": demonstrations.depends,
        "start": start.depends if start else None,
        "code": fingerprint([f"{module}.modeling_{kind}", f"{module}.processor_{kind}"], in_use(config)),
        "versions": _versions("lerobot", "torch", "vector-quantize-pytorch", "transformers"),
    }


def data(row: Row, settings: Settings) -> Step:
    """Make a row's dataset."""
    make = row.data["make"].split()
    options = {name.replace("_", "-"): value for name, value in row.data.items() if name != "make"}
    flags = [f"--{name}" for name, value in options.items() if value is True]
    valued = as_words({name: value for name, value in options.items() if value is not True})
    family = row.family
    where = ("--root={folder}/data", f"--repo-id={_repo_id(row)}")
    return Step(
        kind="data",
        label=row.title,
        parent=settings.root / "data",
        depends={
            "command": " ".join([*make, *valued, *flags]),
            "code": fingerprint([f"dataset_converters.{family}.{make[1]}"]),
            "versions": _versions(*_SIMULATORS[family]),
        },
        template=("python", "-m", f"dataset_converters.{family}", *make[1:], *valued, *flags, *where),
        result="data/meta/info.json",
        seconds=speeds.seconds_of_data(row.world, int(row.data["episodes"])),
    )


def checkpoint(step: Step, at: str = "") -> Path:
    """The policy that a training ends with, or the one after so many steps."""
    last = (step.folder / step.result).parents[1]
    return (last.with_name(_checkpoint_name(int(at))) if at else last) / "pretrained_model"


def _start(row: Row, policy: str, seed: int, settings: Settings) -> Step | None:
    if not row.start:
        return None
    if row.start not in settings.rows:
        raise UserError(f"{row.name}: `start: {row.start}` is no row")
    return training(settings.rows[row.start], policy, seed, settings)


def _short(path: Path) -> Path:
    """As people type it, where they are in the checkout."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _checkpoint_name(steps: int) -> str:
    return f"{steps:06d}"  # LeRobot's


def _repo_id(row: Row) -> str:
    size = int(row.data["episodes"])
    return f"local/{row.world}_{f'{size // 1000}k' if size >= 1000 else size}".lower().replace(" ", "_")


def _label(row: Row, policy: str, seed: int) -> str:
    return row.name if policy == DATA_ONLY else f"{row.name} {policy} seed {seed}"


def _device(settings: Settings) -> dict[str, str]:
    return {"policy.device": settings.device} if settings.device else {}


def _versions(*packages: str) -> dict[str, str | None]:
    return {package: _version(package) for package in packages}


def _version(package: str) -> str | None:
    """Without the build: PyTorch 2.11.0+cu130 and 2.11.0 are one release, for one device and another."""
    try:
        return version(package).partition("+")[0]
    except PackageNotFoundError:
        return None
