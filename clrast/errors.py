"""What can go wrong, as the user sees it: one line, and the exit code of DESIGN section 2.

Every floor of the house may raise these; only the command line turns them into exit codes.
"""

from __future__ import annotations

EXIT_OK = 0
EXIT_CHECK_FAILED = 1
EXIT_USAGE = 64
EXIT_BAD_INPUT = 65
EXIT_NO_INPUT = 66
EXIT_NO_DEVICE = 69
EXIT_INTERNAL = 70
EXIT_CANNOT_WRITE = 73
EXIT_BUDGET = 75
EXIT_INTERRUPTED = 130


class ClrastError(Exception):
    """Base of all errors that users see: `str(error)` is one line of what, where and the mend."""

    exit_code = EXIT_INTERNAL


class UsageError(ClrastError):
    """Options that contradict each other or have values out of range."""

    exit_code = EXIT_USAGE


class SceneError(ClrastError):
    """Input that exists but cannot be rendered: broken, empty, or outside its folder."""

    exit_code = EXIT_BAD_INPUT


class InputNotFoundError(ClrastError):
    """The named input file does not exist."""

    exit_code = EXIT_NO_INPUT


class DeviceError(ClrastError):
    """No OpenCL device works, or the chosen one lacks what was asked for."""

    exit_code = EXIT_NO_DEVICE


class OutputError(ClrastError):
    """The output cannot be written."""

    exit_code = EXIT_CANNOT_WRITE


class CapacityError(ClrastError):
    """A budget of memory or time is too small: the message has both numbers."""

    exit_code = EXIT_BUDGET
