"""Uncaught mistakes of a user end a program in one line; programs that do not use the policies are left alone."""

import programs

PROGRAM = """
import sys
hook = sys.excepthook
import lerobot_lisa
from lerobot_lisa import LisaConfig
import lerobot_lisa.policies.base_processor
assert sys.excepthook is hook, "importing replaced the hook"
{more}
"""
CAUGHT = """
try:
    LisaConfig(device="cpu", n_heads=3)
except Exception:
    pass
1 / 0
"""


def last_lines(more: str) -> list[str]:
    done = programs.run("python", "-c", PROGRAM.format(more=more))
    assert done.returncode == 1
    return done.stderr.split("[end of libtorchcodec")[-1].splitlines()


def test_importing_changes_nothing() -> None:
    assert last_lines("1 / 0")[-1] == "ZeroDivisionError: division by zero"


def test_an_uncaught_user_error_is_one_line() -> None:
    *before, last = last_lines('LisaConfig(device="cpu", n_heads=3)')

    assert last.startswith("error: --policy.dim_model=128 must be even")
    assert not any("Traceback" in line for line in before)


def test_other_errors_stay_as_they_are() -> None:
    assert last_lines(CAUGHT)[-1] == "ZeroDivisionError: division by zero"
