"""The entry point. Exit codes: 0 done, 1 done but the answer is no (see each command), 2 bad input, 130 interrupted."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
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
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names that are not UTF-8, terminals that have not all letters
            stream.reconfigure(errors="backslashreplace")
    with _lossy_stderr():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    code = _guarded(arguments)
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        _drop_output()
    except OSError as error:  # said now, not while Python shuts down
        _drop_output()
        return _complain(_OUTPUT_LOST.format(error.strerror or error), 2)
    return code


class _Lossy:
    """Standard error whose loss ends no command: a full disk behind it, a reader that has gone."""

    def __init__(self, stream: io.TextIOWrapper) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def _lossy_stderr() -> Iterator[None]:
    """``sys.stderr`` as ``_Lossy``; one that was closed before the start goes nowhere, and not to standard output."""
    stream = sys.stderr
    if stream is None:
        with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stderr(nowhere):
            yield
    elif isinstance(stream, io.TextIOWrapper):
        with contextlib.redirect_stderr(_Lossy(stream)):  # type: ignore[type-var]
            yield
    else:
        yield


#: What a command has done is done when its output cannot be written.
_OUTPUT_LOST = "standard output cannot be written ({}); send it elsewhere. Files that were written are complete"


def _guarded(arguments: Sequence[str] | None) -> int:
    """The exit code, errors said in one line; what is no fault of the user's is raised."""
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
    except SystemExit as end:
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        _drop_output()  # as below: the command line's parser says 1
        return 0
    except BrokenPipeError:
        # the reader (head, less) has gone
        _drop_output()
        return 0
    except OSError as error:
        if error.filename is not None or error.errno != errno.ENOSPC:
            raise
        _drop_output()  # a full /dev/full, or the disk that output goes to
        return _complain(_OUTPUT_LOST.format(error.strerror), 2)


def _drop_output() -> None:
    """Let what standard output still holds go nowhere, so that Python does not complain when it ends."""
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # captured, closed
        pass


def _complain(message: str, code: int) -> int:
    print(f"panobench: {' '.join(message.split())}", file=sys.stderr)
    return code


def _one_line_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if category.__module__.startswith("panobench"):
        line = f"panobench: warning: {message}"
    elif not issubclass(category, DeprecationWarning):
        line = f"{category.__name__}: {message}"
    else:
        return
    with contextlib.suppress(OSError):  # also raised outside of a command
        print(line, file=sys.stderr)


if __name__ == "__main__":
    main()
