"""The instructions that LOReL and LISA evaluate, as suites of tasks.

Source: LISA (NeurIPS 2022), tables of the LOReL experiments and its appendix. Instructions that occur twice count
twice, as in the paper.
"""

from types import MappingProxyType

from lerobot_lisa.envs.lorel.tasks import COMPOSITION_STEPS, Task
from lerobot_lisa.errors import UserError

KINDS = ("seen", "unseen verb", "unseen noun", "unseen verb+noun", "human")

# For each task its instruction in the first four kinds above, then what people said.
_REPHRASALS: tuple[tuple[tuple[str, str, str, str], str], ...] = (
    (
        ("close drawer", "shut drawer", "close container", "shut container"),
        "push the drawer shut; push the drawer; shut the drawer; shut drawer; slide the drawer closed; "
        "shut the drawer; shut the dresser; shut the drawer.; shut the cupboard",
    ),
    (
        ("open drawer", "pull drawer", "open container", "pull container"),
        "pull the drawer open; pull the handle; pull the drawer handle; pull the drawer open; pull open the drawer; "
        "open the dresser; pull the drawer; unclose the cabinet",
    ),
    (
        ("turn faucet left", "rotate faucet left", "turn tap left", "rotate tap left"),
        "rotate the tap counterclockwise; turn faucet away from camera; rotate nozzle left; faucet counterclockwise; "
        "rotate the faucet left; turn the faucet to the left; rotate handle to the left; turn faucet counterclockwise; "
        "spin nozzle left",
    ),
    (
        ("turn faucet right", "rotate faucet right", "turn tap right", "rotate tap right"),
        "rotate tap clockwise; turn faucet towards camera; rotate nozzle right; faucet clockwise; "
        "rotate the faucet right; turn the faucet to the right; rotate handle rightward; turn faucet clockwise; "
        "twirl valve right",
    ),
    (
        ("move black mug right", "push black mug right", "move dark cup right", "push dark cup right"),
        "translate the black cup to the right; move black mug away from drawer; push black cup right; black mug right; "
        "slide the black mug right; move the dark mug to the right; push black cup right; move black mug right.; "
        "shift dark cup right",
    ),
    (
        ("move white mug down", "push white mug down", "move light cup down", "push light cup down"),
        "translate the white cup down; move white mug closer to the faucet; bring white cup down; white mug down; "
        "push the white mug down and left; move the lighter mug down; shift white mug down; "
        "pull white mug to the front.; reposition white glass down",
    ),
)

# The 15 of the paper's appendix. The parts of the last three are in no released code; they follow by the same rule.
_COMPOSITIONS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("open cabinet and move black mug right", ("open drawer", "move black mug right")),
    ("pull the handle and move black mug down", ("open drawer", "move black mug down")),
    ("shift white mug right", ("move white mug right",)),
    ("shift black mug down", ("move black mug down",)),
    ("shut drawer and turn faucet right", ("close drawer", "turn faucet right")),
    ("close cabinet and turn faucet left", ("close drawer", "turn faucet left")),
    ("turn faucet left and shift white mug down", ("turn faucet left", "move white mug down")),
    ("rotate faucet right and close drawer", ("turn faucet right", "close drawer")),
    ("move white mug down and rotate faucet left", ("move white mug down", "turn faucet left")),
    ("open drawer and turn faucet counterclockwise", ("open drawer", "turn faucet left")),
    ("slide the drawer closed and then shift white mug down", ("close drawer", "move white mug down")),
    ("rotate faucet left and move white mug down", ("turn faucet left", "move white mug down")),
    ("shift white mug down and shift black mug right", ("move white mug down", "move black mug right")),
    ("turn faucet right and open cabinet", ("turn faucet right", "open drawer")),
    ("move black mug right and turn faucet clockwise", ("move black mug right", "turn faucet right")),
)

# What the released code tests in place of two of the events: another axis each time.
_RELEASED_TESTS = {
    "move black mug down": "move black mug left",
    "move white mug right": "move white mug up",
}


def _rephrasals() -> tuple[Task, ...]:
    return tuple(
        Task(instruction, (row[0],), kind)
        for row, human in _REPHRASALS
        for kind, instruction in [
            *zip(KINDS[:-1], row, strict=True),
            *((KINDS[-1], instruction) for instruction in human.split("; ")),
        ]
    )


def _composition(instruction: str, parts: tuple[str, ...], released: bool) -> Task:
    tests = tuple(_RELEASED_TESTS.get(part, part) for part in parts) if released else ()
    return Task(instruction, parts, "composition", COMPOSITION_STEPS, tests)


SUITES = MappingProxyType(
    {
        "seen": tuple(task for task in _rephrasals() if task.kind == "seen"),
        "rephrasals": _rephrasals(),
        "compositions": tuple(_composition(*row, released=False) for row in _COMPOSITIONS),
        "compositions_as_released": tuple(_composition(*row, released=True) for row in _COMPOSITIONS),
    }
)
"""Suites by name. `compositions` tests what its instructions say; `compositions_as_released` repeats the release's
tests, which look at the wrong axis in three of the 15."""


def find_task(instruction: str) -> Task:
    """The task with an instruction of one of the suites.

    Raises:
        UserError: If there is none.
    """
    for name in ("rephrasals", "compositions"):
        for task in SUITES[name]:
            if task.instruction == instruction:
                return task
    raise UserError(
        f"no LOReL task {instruction!r}: name a suite ({', '.join(SUITES)}) or an instruction of one, "
        "such as 'close drawer'"
    )
