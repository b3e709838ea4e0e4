"""The command line's entry: `python -m clrast` and the console script `clrast`."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code (DESIGN section 2). `argv` excludes the program's name."""
    from clrast.commands.entry import run

    return run(sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
