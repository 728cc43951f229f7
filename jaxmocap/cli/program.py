"""The program `jaxmocap`: its groups of commands, and the exit status of whatever happens."""

import os
import sys

from cyclopts import App

from jaxmocap.cli.calibrate import calibrate
from jaxmocap.cli.demo import demo
from jaxmocap.cli.ending import DONE, INTERRUPTED, WRONG_INPUT, write_usage_failure

app = App(
    name="jaxmocap",
    help="Calibrate cameras and capture motion; every number comes with its standard deviation.",
    version_flags=["--version"],
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
app.command(calibrate)
app.command(demo)


def main() -> None:
    """Run the command line and exit with its status: 0 done, 2 wrong input, 3 not solved, 130 interrupted."""
    try:
        status = app(print_error=True, exit_on_error=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = INTERRUPTED
    except BrokenPipeError:  # the reader of the summary has gone; the files are written
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = DONE
    except Exception as error:
        from cyclopts import CycloptsError

        if not isinstance(error, CycloptsError):
            raise
        write_usage_failure(sys.argv[1:], error)
        status = WRONG_INPUT
    sys.exit(status if isinstance(status, int) else DONE)
