"""The verbs of the command line, as one typer application; a verb's module is imported when it is called."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer

from clrast import __version__
from clrast.commands import messages
from clrast.errors import EXIT_INTERRUPTED, EXIT_OK, UsageError
from clrast.option_values import did_you_mean, listed

ABOUT = "Render triangle scenes with portable OpenCL kernels: the same bits on every machine."

VERBS = {
    "render": ("clrast.commands.render", "render_command", "Render a mesh or a scene card to EXR or PNG."),
    "explain": ("clrast.commands.explain", "explain_command", "Which effects a scene calls for, why, at what cost."),
    "diff": ("clrast.commands.diff", "diff_command", "What changed between two images, every part and channel."),
    "compare": ("clrast.commands.compare", "compare_command", "Every method on one scene: time, counts, a plot."),
    "accuracy": ("clrast.commands.accuracy", "accuracy_command", "Error against time for every knob, on one scene."),
    "cost": ("clrast.commands.cost", "cost_command", "Streaming ray tracing on a grid: passes, bytes, cache, a plot."),
    "stress": ("clrast.commands.stress", "stress_command", "Hard cases by every method, against exact arithmetic."),
    "devices": ("clrast.commands.app", "devices_command", "The OpenCL devices, and whether each passes the self-test."),
}
"""Verb -> module, function, summary."""

EXAMPLES = {
    "": "clrast render bunny.ply -o bunny.exr",
    "render": "clrast render bunny.ply -o bunny.exr -o bunny.png --size 640x480 --eye 0,0.1,0.4 --aov color,depth,id",
    "explain": "clrast explain room.toml --mode whitted",
    "diff": "clrast diff reference.exr test.exr -o difference.png",
    "compare": "clrast compare bunny.ply -o bunny.svg --size 640x480 --repetitions 5",
    "accuracy": "clrast accuracy bunny.ply --time 2 --html bunny.html -o bunny.svg",
    "cost": "clrast cost bunny.ply -o cost.svg --size 512x512",
    "stress": "clrast stress --failures wrong -o stress.html",
    "devices": "clrast devices --json",
}

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


def devices_command(
    json_output: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
) -> int:
    """List the OpenCL devices with their self-test, and the one that render takes."""
    from clrast.commands.devices import run

    return run(json_output)


def invoke(arguments: Sequence[str], started: float) -> int:
    """Parse `arguments` and run the verb; returns its exit code. `started` : perf_counter at the start, seconds."""
    verb = arguments[0] if arguments else ""
    if not verb:
        raise UsageError(f"no command given: use {listed(tuple(VERBS))}, or 'clrast --help'")
    if not verb.startswith("-") and verb not in VERBS:
        hint = did_you_mean(verb, tuple(VERBS))
        raise UsageError(f"there is no command '{verb}': use {listed(tuple(VERBS))}{hint}")
    command = typer.main.get_command(_build(verb))
    try:
        result = _parse(command, arguments, started)
        if callable(result):
            result = result()
    except typer.Exit as leaving:
        result = leaving.exit_code
    if result == EXIT_INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else EXIT_OK


def _parse(command: Any, arguments: Sequence[str], started: float) -> Any:
    """The bound verb, or an exit code where the parser itself answered (a help page, the version)."""
    try:
        return command.main(list(arguments), prog_name="clrast", standalone_mode=False, obj={"started": started})
    except SystemExit:
        # The parser leaves like this when the reader of a help page has gone.
        raise BrokenPipeError from None
    except OSError as fault:
        raise messages.stdout_fault(fault) from None


def _build(wanted: str) -> typer.Typer:
    """The application, with the module of the `wanted` verb imported and the others as names for the help."""
    app = typer.Typer(
        name="clrast",
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings=CONTEXT,
    )
    app.callback(help=ABOUT, epilog=_example(""))(_top)
    for verb, (module, function, summary) in VERBS.items():
        body = getattr(import_module(module), function) if verb == wanted else _named_only
        app.command(verb, short_help=summary, epilog=_example(verb), context_settings=CONTEXT)(_deferred(body))
    return app


def _example(verb: str) -> str:
    """The last lines of a help page; the control character keeps the line as it is."""
    return f"\b\nExample:\n  {EXAMPLES[verb]}"


def _print_version(asked: bool) -> None:
    if asked:
        print(f"clrast {__version__}")
        raise typer.Exit(EXIT_OK)


def _top(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Stands before the verbs and takes the options of the program as a whole."""


def _named_only() -> None:
    """Stands for a verb that this command line does not call."""


def _deferred(function: Callable[..., Any]) -> Callable[..., Callable[[], Any]]:
    """A command that only binds its arguments: the work runs outside the parser, which swallows some exceptions."""

    @functools.wraps(function)
    def bind(*values: Any, **named: Any) -> Callable[[], Any]:
        return functools.partial(function, *values, **named)

    return bind
