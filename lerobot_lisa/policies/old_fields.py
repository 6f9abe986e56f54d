"""Names that fields of the configurations had in version 0.1: what still has them is refused in one line.

draccus, which reads LeRobot's files, answers an unknown field with a traceback, and takes no decoder of a policy's own.
"""

from dataclasses import dataclass, field
from typing import Any

from lerobot_lisa.errors import UserError


class _Old:
    """Reads as None; being set to anything else, which is how draccus sets fields with `init=False`, is an error."""

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: object, owner: type | None = None) -> None:
        return None

    def __set__(self, instance: object, value: Any) -> None:
        if value is not None:
            raise UserError(
                f"`{self.name}: {value}` is a setting of version 0.1: it is called {self.new} now; "
                "checkpoints of that version cannot be loaded (install it, or train again)"
            )


@dataclass
class OldFields:
    """Fields that no option sets and no file gets."""

    width: Any = field(init=False, repr=False, default=_Old("dim_model"))
    heads: Any = field(init=False, repr=False, default=_Old("n_heads"))
    layers: Any = field(init=False, repr=False, default=_Old("n_layers"))
    predictor_layers: Any = field(init=False, repr=False, default=_Old("n_predictor_layers"))
    policy_layers: Any = field(init=False, repr=False, default=_Old("n_policy_layers"))
    continuous_skills: Any = field(init=False, repr=False, default=_Old("quantizer=continuous"))
    image_backbone: Any = field(init=False, repr=False, default=_Old("vision_backbone"))
    image_backbone_weights: Any = field(init=False, repr=False, default=_Old("pretrained_backbone_weights"))
