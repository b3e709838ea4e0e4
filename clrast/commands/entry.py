"""From an argument list to an exit code: every error becomes one line on stderr and its code."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence

from clrast.commands import messages
from clrast.errors import (
    EXIT_BAD_INPUT,
    EXIT_BUDGET,
    EXIT_CANNOT_WRITE,
    EXIT_INTERNAL,
    EXIT_INTERRUPTED,
    EXIT_NO_INPUT,
    EXIT_USAGE,
    ClrastError,
)

EXIT_BROKEN_PIPE = 141
"""What a shell reports for a program that dies of a closed pipe."""
EXIT_DIFF_UNREADABLE = 4
DEBUG_VARIABLE = "CLRAST_DEBUG"


def run(arguments: Sequence[str]) -> int:
    """Run one command line (without the program's name) and return its exit code; never raises."""
    started = time.perf_counter()
    arguments = list(arguments)

    def command() -> int:
        from clrast.commands.app import invoke

        return invoke(arguments, started)

    verb = arguments[0] if arguments else ""
    with warnings.catch_warnings():
        if not _debugging():
            warnings.simplefilter("ignore")
        code = _guarded(command, verb)
    return _flush(code)


def _debugging() -> bool:
    return os.environ.get(DEBUG_VARIABLE, "") not in ("", "0")


def _guarded(command: Callable[[], int], verb: str) -> int:
    """Exit code of `command()`; whatever it raises is said in one line."""
    try:
        return command()
    except ClrastError as fault:
        _traceback()
        messages.error(str(fault))
        unreadable = fault.exit_code in (EXIT_BAD_INPUT, EXIT_NO_INPUT)
        return EXIT_DIFF_UNREADABLE if verb == "diff" and unreadable else fault.exit_code
    except KeyboardInterrupt:
        messages.error("interrupted")
        return EXIT_INTERRUPTED
    except MemoryError as fault:
        _traceback()
        messages.error(f"out of memory ({fault or 'host'}): use a smaller --size or fewer --aov groups")
        return EXIT_BUDGET
    except BrokenPipeError:
        return EXIT_BROKEN_PIPE
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else EXIT_INTERNAL
    except Exception as fault:
        if hasattr(fault, "format_message"):
            messages.error(_usage_line(fault, verb))
            return EXIT_USAGE
        _traceback()
        kind = type(fault).__name__
        hint = f"set {DEBUG_VARIABLE}=1 for the traceback"
        messages.error(f"a fault of clrast, not of yours: {kind}: {fault}; please report it ({hint})")
        return EXIT_INTERNAL


def _usage_line(fault: Exception, verb: str) -> str:
    """What the argument parser found wrong, and where to read on."""
    message = str(fault.format_message()).rstrip(".")  # type: ignore[attr-defined]
    page = f"clrast {verb} --help" if verb and not verb.startswith("-") else "clrast --help"
    return f"{message}: see '{page}'"


def _traceback() -> None:
    if _debugging():
        import traceback

        traceback.print_exc()


def _flush(code: int) -> int:
    """Flush stdout, so that a full disk or a closed pipe is found here and not at interpreter exit."""
    if sys.stdout is None:
        return code
    try:
        sys.stdout.flush()
        if code != EXIT_BROKEN_PIPE:
            return code
    except BrokenPipeError:
        code = EXIT_BROKEN_PIPE
    except OSError as fault:
        messages.error(str(messages.stdout_fault(fault)))
        code = EXIT_CANNOT_WRITE
    except ValueError:
        return code
    _silence_stdout()
    return code


def _silence_stdout() -> None:
    """Send what is left in stdout's buffer nowhere."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    except (OSError, ValueError):
        pass
