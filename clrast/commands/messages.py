"""Lines on stderr: notes, warnings and errors, each of them exactly one line."""

from __future__ import annotations

import re
import sys

from clrast.errors import OutputError

_LINE_ENDS = re.compile(r"\s*[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]\s*")
_CONTROLS = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")


def one_line(text: str) -> str:
    """The text on one line: line ends become spaces, other control characters are written as escapes."""
    folded = _LINE_ENDS.sub(" ", text.strip()).replace("\t", " ")
    return _CONTROLS.sub(lambda match: f"\\x{ord(match.group()):02x}", folded)


def say(text: str) -> None:
    """One line on stderr; a closed stderr is no error."""
    if sys.stderr is None:
        return
    try:
        print(one_line(text), file=sys.stderr, flush=True)
    except (OSError, ValueError):
        pass


def result(text: str) -> None:
    """What was asked for, on stdout, ending in a line end; raises OutputError where stdout cannot take it."""
    try:
        print(text.rstrip("\n"))
    except BrokenPipeError:
        raise
    except OSError as fault:
        raise stdout_fault(fault) from None


def stdout_fault(fault: OSError) -> OutputError:
    return OutputError(f"cannot write to standard output: {fault.strerror}: free space or send it elsewhere")


def note(text: str) -> None:
    say(f"clrast: {text}")


def warn(text: str) -> None:
    say(f"warning: {text}")


def error(text: str) -> None:
    say(f"clrast: error: {text}")
