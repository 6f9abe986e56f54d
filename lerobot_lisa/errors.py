"""The one exception for mistakes a user can mend, shown as one line instead of a traceback."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType


class UserError(Exception):
    """Bad input: the message is one line that names the file or field, what is wrong with it, and the fix.

    No `ValueError`: the parser of LeRobot's command lines would put its own words in place of ours.

    The first one lets uncaught ones end any program, `lerobot-train` included, with that line and exit code 1:
    importing this package changes nothing in a process that uses other policies only.
    """

    def __init__(self, message: str) -> None:
        """Note the message."""
        super().__init__(message)
        _show_user_errors_in_one_line()


def exit_code(work: Callable[[], object], interrupted: str = "interrupted") -> int:
    """Do the work of a command line and return its exit code.

    Returns:
        0; 1 after a `UserError` or what the file system refuses (a full disk, a file where a folder should be, a name
        that is too long), 130 after Ctrl-C, each with one line on standard error.
    """
    try:
        work()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {_refusal(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)
        return 130
    return 0


def _refusal(error: OSError) -> str:
    """What the operating system says, after the file that it says it of."""
    named = next((str(name) for name in (error.filename, error.filename2) if name is not None), "")
    shown = named if len(named) <= 200 else f"{named[:100]}…{named[-50:]}"
    if isinstance(error, FileExistsError) and Path(named).is_symlink():  # else it would be used
        return f"{shown}: a link that leads nowhere: delete it, or make what it names"
    said = error.strerror or " ".join(str(error).split()) or type(error).__name__
    return f"{shown}: {said}" if shown else said


def _show_user_errors_in_one_line() -> None:
    """Every other exception goes to the hook that was there before."""
    previous = sys.excepthook
    if getattr(previous, "shows_user_errors", False):
        return

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if isinstance(error, UserError):
            print(f"error: {error}", file=sys.stderr)
        else:
            previous(kind, error, trace)

    hook.shows_user_errors = True  # type: ignore[attr-defined]
    sys.excepthook = hook
