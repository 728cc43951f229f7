"""The program `jaxmocap`: its groups of commands, and the exit status of whatever happens."""

import os
import sys
from collections.abc import Sequence
from io import TextIOWrapper

from cyclopts import App, CycloptsError

from jaxmocap._errors import InputError
from jaxmocap.cli.calibrate import calibrate
from jaxmocap.cli.demo import demo
from jaxmocap.cli.ending import DONE, INTERRUPTED, WRONG_INPUT, failed, write_usage_failure
from jaxmocap.cli.puppet import puppet
from jaxmocap.cli.view import view

app = App(
    name="jaxmocap",
    help="Calibrate cameras and capture motion; every number comes with its standard deviation.",
    version_flags=["--version"],
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
app.command(calibrate)
app.command(demo)
app.command(view)
app.command(puppet)


def main() -> None:
    """Run the command line and exit with its status: 0 done, 2 wrong input, 3 not solved, 130 interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a terminal in another encoding shows \\u00b1 rather than nothing
            stream.reconfigure(errors="backslashreplace")
    try:
        _refuse_unnameable(sys.argv[1:])
        status = app(sys.argv[1:], print_error=True, exit_on_error=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = INTERRUPTED
    except BrokenPipeError:  # the reader of the summary has gone; the files are written
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = DONE
    except InputError as error:
        write_usage_failure(sys.argv[1:], error)
        status = failed(str(error), WRONG_INPUT)
    except CycloptsError as error:
        write_usage_failure(sys.argv[1:], error)
        status = WRONG_INPUT
    sys.exit(status if isinstance(status, int) else DONE)


def _refuse_unnameable(arguments: Sequence[str]) -> None:
    """Refuse names that neither a report nor a table can hold: results record the command line."""
    for argument in arguments:
        try:
            argument.encode("utf-8")
        except UnicodeEncodeError:  # half of a surrogate pair: how Python shows a byte that is not UTF-8
            raise InputError(
                f"argument {ascii(argument)}: not UTF-8, so that no result could record it. The name probably comes "
                "from a system with another encoding: rename the file or folder."
            ) from None
