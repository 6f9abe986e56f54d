"""`lisa-reproduce`: rows of the paper's tables from nothing to their numbers, with LeRobot's own commands.

lisa-reproduce --list                          # every row: what it needs, how long it takes, whether it was run
lisa-reproduce table1.gotoseq_1k               # data, training of all its policies, evaluation; goes on where it was
lisa-reproduce ablations --seeds 0 1 --jobs 2  # a table; --dry-run shows commands and the estimate
lisa-reproduce table1.gotoseq_1k --also mine=my_recipe.yaml  # a policy of your own beside the paper's
lisa-reproduce table1 --executor slurm --partition gpu       # on a cluster
"""

import argparse
import shlex
import signal
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from lerobot_lisa.errors import UserError, exit_code
from lerobot_lisa.reproduce.listing import estimate, outcomes, overview
from lerobot_lisa.reproduce.outcomes import State, keep, read_published, state
from lerobot_lisa.reproduce.plan import Run, Settings, plan
from lerobot_lisa.reproduce.results import publish, render_page
from lerobot_lisa.reproduce.rows import Row, choose, read_rows
from lerobot_lisa.reproduce.run import in_order, run_here, say_failures
from lerobot_lisa.reproduce.steps import Step

_MODULES = {
    "babyai": ("minigrid",),
    "lorel": ("mujoco", "metaworld"),
    "metaworld": ("mujoco", "metaworld"),
    "reproduce": ("doit",),
    "scale": ("datatrove",),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    if not (options.rows or options.list or options.render or options.publish):
        _parser().print_usage(sys.stderr)
        return 2
    return exit_code(lambda: _work(options), "interrupted; run the same command again to go on")


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", help="rows such as table1.gotoseq_1k, or tables such as ablations")
    parser.add_argument("--list", action="store_true", help="rows (default: all) and where they stand; runs nothing")
    parser.add_argument("--render", action="store_true", help="write docs/results.md anew from docs/results")
    parser.add_argument("--publish", action="store_true", help="put what came out of rows into docs/results")
    parser.add_argument("--dry-run", action="store_true", help="show the commands that are left, and run nothing")
    parser.add_argument("--seeds", type=int, nargs="+", help="of the trainings (default: those of the row)")
    parser.add_argument("--policies", nargs="+", help="some of a row's policies (default: all)")
    parser.add_argument("--also", action="append", default=[], metavar="NAME=RECIPE", help="a policy of your own")
    parser.add_argument("--own-rows", type=Path, metavar="DIR", help="with rows of your own, <table>/<row>.yaml")
    parser.add_argument("--root", type=Path, default=Path("outputs/reproduce"), help="for everything made")
    parser.add_argument("--device", default="", help="for networks (default: LeRobot chooses)")
    parser.add_argument("--jobs", type=int, default=1, help="steps at a time (default 1)")
    parser.add_argument("--executor", choices=["local", "slurm"], default="local", help="where (default: here)")
    parser.add_argument("--partition", help="of SLURM")
    parser.add_argument("--time", default="24:00:00", help="limit of a SLURM job (default 24:00:00)")
    parser.add_argument("--memory", type=int, default=8, help="GB for a SLURM job (default 8)")
    parser.add_argument("--gpus", type=int, default=0, help="for a SLURM job with networks in it (default 0)")
    parser.add_argument("--qos", default="", help="of SLURM")
    return parser


def _work(options: argparse.Namespace) -> None:
    rows_by_name = read_rows(options.own_rows)
    root = options.root.absolute() if options.executor == "slurm" else options.root  # jobs start anywhere
    settings = Settings(rows_by_name, root, options.device, dict(_own(word) for word in options.also))
    rows = choose(options.rows, rows_by_name) if options.rows else list(rows_by_name.values())
    runs = _runs(rows, settings, options)
    keep(runs, settings)
    if options.list:
        print(*overview(_states(runs, settings)), sep="\n")
    elif options.publish:
        print(*publish(_states(runs, settings)), sep="\n")
    elif options.rows:
        _run_rows(rows, runs, settings, options)
    if options.render or options.publish:
        render_page()


def _runs(rows: list[Row], settings: Settings, options: argparse.Namespace) -> list[Run]:
    if options.jobs < 1:
        raise UserError(f"--jobs={options.jobs}: give 1 or more")
    runs = plan(rows, settings, options.seeds)
    if not options.policies:
        return runs
    chosen = [run for run in runs if run.kind in options.policies]
    if unknown := set(options.policies) - {run.kind for run in chosen}:
        known = ", ".join(dict.fromkeys(run.kind for run in runs))
        raise UserError(f"--policies {sorted(unknown)[0]}: these rows have {known}")
    return chosen


def _run_rows(rows: list[Row], runs: list[Run], settings: Settings, options: argparse.Namespace) -> None:
    steps = in_order(run.step for run in runs if run.step)
    print(*estimate(steps, options.jobs), sep="\n")
    if options.dry_run:
        print(*_commands(steps), sep="\n")
        return
    _check_extras([row.family for row in rows] + (["reproduce"] if options.executor == "local" else []))
    if options.executor == "slurm":
        _queue(steps, options)
        return
    signal.signal(signal.SIGTERM, _interrupt)  # what ends a job on a cluster is no other than Ctrl-C
    try:
        failures = run_here(steps, options.jobs)
    finally:
        keep(runs, settings)
    print(*outcomes(_states(runs, settings)), sep="\n")
    say_failures(failures)


def _states(runs: list[Run], settings: Settings) -> list[tuple[Run, State]]:
    published = read_published()
    return [(run, state(run, settings, published)) for run in runs]


def _commands(steps: Sequence[Step]) -> list[str]:
    whole = {step.name: step for last in steps for step in last.chain()}
    return [shlex.join(step.next_command) for step in whole.values() if step.note is None]


def _check_extras(extras: list[str]) -> None:
    """Before hours of work, not after them."""
    for extra in dict.fromkeys(extras):
        for module in _MODULES.get(extra, ()):
            if find_spec(module) is None:
                raise UserError(f'{module} is missing: pip install "lerobot_policy_lisa[{extra}]"')


def _queue(steps: Sequence[Step], options: argparse.Namespace) -> None:
    if not options.partition:
        raise UserError("--executor=slurm needs --partition, the SLURM partition to run on")
    _check_extras(["scale"])
    from dataset_converters.cluster.slurm import Slurm
    from lerobot_lisa.reproduce.slurm import slurm_executor  # only this needs datatrove

    slurm = Slurm(options.partition, options.time, options.memory, options.qos)
    last = slurm_executor(steps, options.jobs, slurm, options.root.absolute(), options.gpus)
    if last is None:
        print("everything is done: nothing to queue")
        return
    last.run()
    print(f"queued; `lisa-reproduce --list` says how far it is, logs: {options.root / 'slurm'}")


def _own(word: str) -> tuple[str, Path]:
    name, _, path = word.partition("=")
    if not name.isidentifier() or not Path(path).is_file():
        raise UserError(f"--also {word}: give a name and a recipe that is there, such as mine=my_recipe.yaml")
    return name, Path(path)


if __name__ == "__main__":
    sys.exit(main())
