"""A command group that imports a command's module only when that command is invoked."""

from __future__ import annotations

import difflib
import importlib
import warnings
from collections.abc import Iterable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from panobench import kernel_cache
from panobench.cli.commands import COMMANDS, COMPUTING
from panobench.errors import PanobenchWarning


def load_command(name: str) -> Any:
    """The click command of ``panobench NAME``."""
    path, summary = COMMANDS[name]
    module = importlib.import_module(path)
    app = getattr(module, "app", None)
    if app is None:
        app = typer.Typer()
        app.command()(getattr(module, name))
    command = typer.main.get_command(app)
    command.name = name
    tidy_help(command)
    command.short_help = summary
    return command


def tidy_help(command: Any) -> None:
    """Leave the options that install completion to `panobench` itself, and show no type for what is a switch."""
    listed = command.get_params

    def get_params(ctx: Any) -> list[Any]:
        return without_types(p for p in listed(ctx) if p.name not in ("install_completion", "show_completion"))

    command.get_params = get_params
    for inner in getattr(command, "commands", {}).values():
        tidy_help(inner)


def without_types(parameters: Iterable[Any]) -> list[Any]:
    """The parameters; help shows no type for those that are switches."""
    found = list(parameters)
    for parameter in found:
        if getattr(parameter, "is_bool_flag", False):
            parameter.metavar = ""
    return found


class LazyGroup(TyperGroup):
    """Lists commands from the table alone, and imports a command's module in ``resolve_command``."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_params(self, ctx: Any) -> list[Any]:
        return without_types(super().get_params(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A stand-in that knows the command's line of help, which is enough for listing and completing names."""
        if cmd_name not in COMMANDS:
            return None
        summary = COMMANDS[cmd_name][1]
        return TyperCommand(cmd_name, help=summary, short_help=summary)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name = args[0]
        if name in COMMANDS:
            if name in COMPUTING and not {"-h", "--help"} & set(args):
                _say_where_kernels_are()
            return name, load_command(name), args[1:]
        if not name.startswith("-") and not ctx.resilient_parsing:
            close = difflib.get_close_matches(name, COMMANDS, n=1, cutoff=0.5)
            hint = f"did you mean '{close[0]}'? " if close else ""
            ctx.fail(f"unknown command '{name}': {hint}known: {', '.join(COMMANDS)}")
        return super().resolve_command(ctx, args)


def _say_where_kernels_are() -> None:
    """A warning if they are compiled into a temporary folder. Raises UnavailableError where there is not even that."""
    kernel_cache.require()
    line = kernel_cache.note()
    if line is not None:
        warnings.warn(line, PanobenchWarning, stacklevel=2)
