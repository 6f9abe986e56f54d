"""The one exception for mistakes a user can mend, shown as one line instead of a traceback."""

import sys
from types import TracebackType


class UserError(ValueError):
    """Bad input: the message is one line that names the file or field, what is wrong with it, and the fix."""


def show_user_errors_in_one_line() -> None:
    """Let an uncaught `UserError` end any program, `lerobot-train` included, with one line and exit code 1.

    Every other exception goes to the hook that was there before.
    """
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
