"""`clrast devices`: each OpenCL device, whether it works, and which one `render` takes and why."""

from __future__ import annotations

import json
from typing import Any

from clrast.commands import messages
from clrast.errors import EXIT_NO_DEVICE, EXIT_OK
from clrast.opencl import runtimes
from clrast.opencl.device import ListedDevice, list_devices, preferred, self_test, vector_width


def run(json_output: bool = False) -> int:
    """Print the table, or JSON; the exit code is 69 where no device works."""
    listed = list_devices()
    rows = [_row(device) for device in listed]
    chosen = next((d for d in preferred(listed) if self_test(d.handle, d.index).ok), None)
    why = _why(chosen, listed)
    if json_output:
        summary = {"chosen": chosen.index if chosen else None, "why": why, "devices": rows}
        messages.result(json.dumps(summary, indent=2, ensure_ascii=False))
    else:
        _print_table(rows)
        if chosen:
            messages.result(f"render takes {chosen.index} {chosen.name}: {why}")
    if chosen is None:
        messages.error(f"{why}: {runtimes.MEND}")
        return EXIT_NO_DEVICE
    return EXIT_OK


def _row(device: ListedDevice) -> dict[str, Any]:
    result = self_test(device.handle, device.index)
    handle = device.handle
    return {
        "index": device.index,
        "runtime": device.runtime,
        "name": device.name,
        "platform": device.platform,
        "version": device.version,
        "driver": device.driver,
        "kind": device.kind,
        "works": result.ok,
        "reason": result.reason,
        "self_test_ms": round(result.milliseconds, 1),
        "compute_units": handle.max_compute_units,
        "local_memory_bytes": handle.local_mem_size,
        "global_memory_bytes": handle.global_mem_size,
        "float64": "cl_khr_fp64" in handle.extensions.split(),
        "vector_width": vector_width(device),
        "known_faults": list(runtimes.known_faults(device.runtime, f"{device.version}, {device.driver}")),
    }


def _why(chosen: ListedDevice | None, listed: list[ListedDevice]) -> str:
    """One line: the place of the chosen device in the order of preference, or why there is none."""
    if not listed:
        return "there is no OpenCL device"
    if chosen is None:
        return "no OpenCL device passes the self-test"
    order = ", ".join(runtimes.PREFERENCE)
    failed = [d.index for d in preferred(listed) if not self_test(d.handle, d.index).ok]
    before = f"; {', '.join(failed)} failed" if failed else ""
    return f"the first that passes the self-test in the order {order}{before}; --device takes another"


def _print_table(rows: list[dict[str, Any]]) -> None:
    """The table, then a line for each failure and each known fault."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    if not rows:
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("device", "runtime", "name", "driver", "units", "fp64", "self-test"):
        table.add_column(heading, no_wrap=heading != "name", overflow="fold")
    notes = []
    for row in rows:
        verdict = f"passed, {row['self_test_ms']:.0f} ms" if row["works"] else "FAILED"
        cells = (row["index"], row["runtime"], row["name"], row["driver"], str(row["compute_units"]))
        table.add_row(*map(Text, cells), "yes" if row["float64"] else "no", verdict)
        if not row["works"]:
            notes.append(f"{row['index']} failed: {row['reason']}")
        notes += [f"{row['index']} known: {fault}" for fault in row["known_faults"]]
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    with console.capture() as captured:
        console.print(table)
    lines = [line.rstrip() for line in captured.get().strip("\n").splitlines()]
    messages.result("\n".join([line for line in lines if line] + notes))
