"""Make command-line options from the fields of RunRequest."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, get_origin

import typer

from panobench.bench.run.config import parse_settings
from panobench.bench.run.request import RunOption


def with_run_options(
    options: Iterable[RunOption], help: Callable[[RunOption], str]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command with a command-line option for each run option, after the arguments that it requires itself.

    The command's first parameter is ``given``: the values by name, fit for ``RunRequest(**given)``. Settings are parsed
    from KEY=VALUE; a word of another form raises UsageError.
    """
    chosen = tuple(options)

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

        def called(**values: Any) -> None:
            given = {option.name: values.pop(option.name) for option in chosen}
            for option in chosen:
                if _is_mapping(option):
                    given[option.name] = parse_settings(given[option.name] or ())
            command(given, **values)

        required = [p for p in own if p.default is inspect.Parameter.empty]
        parameters = [*required, *(_parameter(o, help(o)) for o in chosen), *(p for p in own if p not in required)]
        keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
        called.__name__, called.__doc__ = command.__name__, command.__doc__
        called.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
        called.__annotations__ = {p.name: p.annotation for p in keywords}
        return called

    return decorate


def _parameter(option: RunOption, help: str) -> inspect.Parameter:
    if _is_mapping(option):
        about = typer.Option(option.flag, metavar="KEY=VALUE", help=help)
        return inspect.Parameter(
            option.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[list[str] | None, about]
        )
    flag = f"{option.flag}/--no-{option.flag[2:]}" if option.type is bool else option.flag
    about = typer.Option(flag, help=help)
    return inspect.Parameter(
        option.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=option.default,
        annotation=Annotated[option.type, about],
    )


def _is_mapping(option: RunOption) -> bool:
    return get_origin(option.type) is not None and issubclass(get_origin(option.type), Mapping)
