"""How every command of the analysis starts: LeRobot's parser and options with dots, and one line for every mistake."""

import json
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any, get_type_hints

from draccus.cfgparsing import parse_string
from lerobot.configs import parser
from lerobot.utils.import_utils import register_third_party_plugins
from yaml import YAMLError

from lerobot_lisa.errors import UserError, exit_code

_AGAIN = "interrupted; run the same command again to go on"


def run_command(work: Callable[[Any], object], listed: str = "", interrupted: str = _AGAIN) -> int:
    """Read the command line into the configuration that `work` takes, and do the work.

    Args:
        work: Its one argument is annotated with a dataclass; `--a.b=c` sets a field of it.
        listed: Field for what stands before the first option, such as files that a shell's `*` has found.
        interrupted: Said after Ctrl-C.

    Returns:
        Exit code: 0; 1 after a mistake that the user can mend, 2 after a wrong option, 130 after Ctrl-C.
    """
    register_third_party_plugins()
    if listed:
        sys.argv = [sys.argv[0], *_as_option(listed, sys.argv[1:])]
    return exit_code(lambda: work(_parse(work)), interrupted)


def _parse(work: Callable[[Any], object]) -> Any:
    """The command line as the dataclass that `work` takes; LeRobot lets most of the parser's errors through."""
    from draccus.utils import DraccusException

    def keep(config: Any) -> Any:
        return config

    keep.__annotations__["config"] = next(iter(get_type_hints(work).values()))
    try:
        return parser.wrap()(keep)()
    except (DraccusException, parser.ArgumentError, ValueError, YAMLError) as error:
        named = [] if isinstance(error, DraccusException | parser.ArgumentError) else _unreadable()
        reasons = [*named, *(str(reason) for reason in (error, error.__cause__) if reason is not None)]
        raise UserError(" ".join(": ".join(reasons).split()) or "the options cannot be read: see --help") from error


def _unreadable() -> list[str]:
    """The option that YAML cannot read, or the file of options, which the errors about them do not name."""
    for before, word in pairwise(sys.argv):
        option, _, value = word.partition("=") if word.startswith("--") else (before, "", word)
        try:
            parse_string(value)
        except (ValueError, YAMLError):
            return [f"{option} is no YAML, which LeRobot takes options for"]
    return [path for path in [parser.parse_arg("config_path")] if path]


def _as_option(name: str, words: list[str]) -> list[str]:
    first = next((place for place, word in enumerate(words) if word.startswith("-")), len(words))
    return [f"--{name}={json.dumps(words[:first])}", *words[first:]] if first else words


def check_number(option: str, value: int, lowest: int, highest: int) -> None:
    """Refuse a number that cannot work.

    Raises:
        UserError: It is below `lowest` or above `highest`.
    """
    if not lowest <= value <= highest:
        said = value if abs(value) < 10**20 else "a number of more than 20 digits"
        raise UserError(f"--{option}={said}: give a number from {lowest:,} to {highest:,}")
