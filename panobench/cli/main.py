"""The entry point. Exit codes: 0 done, 1 done but the answer is no (see each command), 2 bad input, 130 interrupted."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from panobench.cli.lazy import LazyGroup
from panobench.errors import PanobenchError

INTERRUPTED = 130

# typer brings its own copy of click from 0.26 on; this finds the class of command-line errors in both
_CommandLineError: Any = typer.BadParameter.__mro__[2]

app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Benchmark visual SLAM with panoramic cameras.",
)


def _version(value: bool) -> None:
    if value:
        from panobench import __version__

        print(f"panobench {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit. A PanobenchError prints one line on stderr; other errors show a traceback."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    warnings.showwarning = _one_line_warning
    try:
        code = typer.main.get_command(app).main(
            list(sys.argv[1:] if arguments is None else arguments), prog_name="panobench", standalone_mode=False
        )
        return code if isinstance(code, int) else 0
    except PanobenchError as error:
        return _complain(str(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        return _complain("interrupted", INTERRUPTED)
    except _CommandLineError as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            print(error.format_message())
            return 2
        return _complain(error.format_message(), 2)
    except BrokenPipeError:
        # the reader (head, less) has gone
        sys.stderr.close()
        return 0


def _complain(message: str, code: int) -> int:
    print(f"panobench: {' '.join(message.split())}", file=sys.stderr)
    return code


def _one_line_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if category.__module__.startswith("panobench"):
        print(f"panobench: warning: {message}", file=sys.stderr)
    elif not issubclass(category, DeprecationWarning):
        print(f"{category.__name__}: {message}", file=sys.stderr)


if __name__ == "__main__":
    main()
