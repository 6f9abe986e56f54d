"""Ways to say LOReL's tasks, and instructions that share only the verb or only the object with them.

Source: the paper's appendix, "Are the skill codes in LISA chosen because of environment affordances and not
language?": its instructions for the drawer are those of "close drawer" here; the other tasks follow its pattern.
"""

from itertools import product
from typing import NamedTuple

from lerobot_lisa.errors import UserError

SAME, OTHER_VERB, OTHER_OBJECT = "same meaning", "same object, other verb", "same verb, other object"


class Meaning(NamedTuple):
    """Words of a task.

    Attributes:
        verbs: Ways to say what to do, `{}` for the object.
        objects: Ways to say what to do it with.
        other_verbs: Something else to do with the same object.
        other_objects: Something else to do it with.
    """

    verbs: tuple[str, ...]
    objects: tuple[str, ...]
    other_verbs: tuple[str, ...]
    other_objects: tuple[str, ...]


_DRAWER, _FAUCET = ("drawer", "container"), ("faucet", "tap")
_OPEN, _SHUT = ("open {}", "pull {}"), ("close {}", "push {}")
_NOT_TO_MUGS = ("close {}", "open {}", "rotate {}")

MEANINGS = {
    "close drawer": Meaning(_SHUT, _DRAWER, ("rotate {}", "move {} down", *_OPEN), ("mug", "faucet")),
    "open drawer": Meaning(_OPEN, _DRAWER, ("rotate {}", "move {} down", *_SHUT), ("mug", "faucet")),
    "turn faucet left": Meaning(
        ("turn {} left", "rotate {} left"),
        _FAUCET,
        ("turn {} right", "rotate {} right", "move {} down", "close {}", *_OPEN),
        ("mug", "drawer"),
    ),
    "turn faucet right": Meaning(
        ("turn {} right", "rotate {} right"),
        _FAUCET,
        ("turn {} left", "rotate {} left", "move {} down", "close {}", *_OPEN),
        ("mug", "drawer"),
    ),
    "move black mug right": Meaning(
        ("move {} right", "push {} right"),
        ("black mug", "dark cup"),
        ("move {} left", "move {} up", "move {} down", *_NOT_TO_MUGS),
        ("drawer", "faucet", "white mug"),
    ),
    "move white mug down": Meaning(
        ("move {} down", "push {} down"),
        ("white mug", "light cup"),
        ("move {} up", "move {} left", "move {} right", *_NOT_TO_MUGS),
        ("drawer", "faucet", "black mug"),
    ),
}
"""Words of the six tasks of LOReL's suites, by their seen instruction."""


def instructions_about(task: str) -> dict[str, list[str]]:
    """Instructions by what they share with a task: `SAME` (the task's own comes first), `OTHER_VERB`, `OTHER_OBJECT`.

    Raises:
        UserError: There is no such task.
    """
    if task not in MEANINGS:
        raise UserError(f"--env.task={task}: choose one of: {', '.join(MEANINGS)}")
    words = MEANINGS[task]
    return {
        SAME: list(dict.fromkeys([task, *_all(words.verbs, words.objects)])),
        OTHER_VERB: _all(words.other_verbs, words.objects),
        OTHER_OBJECT: _all(words.verbs, words.other_objects),
    }


def _all(verbs: tuple[str, ...], objects: tuple[str, ...]) -> list[str]:
    return [verb.format(thing) for verb, thing in product(verbs, objects)]
