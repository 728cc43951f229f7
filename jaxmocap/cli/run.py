"""One way to run a command: check the places, do the work, write all files or none, say what came of it."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxmocap._errors import JaxMocapError
from jaxmocap.cli.ending import DONE, NOT_SOLVED, Outputs, failed, status_of, write_failure
from jaxmocap.cli.jax_setup import use_jax
from jaxmocap.cli.places import check_places


@dataclass(frozen=True)
class Outcome:
    """What a command has to say and to write."""

    summary: str
    files: Mapping[str | Path, bytes]
    notes: tuple[str, ...] = ()
    refused: str = ""
    """Why the result is not to be used; `files` then holds report and JSON alone, and the exit status is 3."""


def run(
    job: Callable[[], Outcome], outputs: Outputs, inputs: Sequence[str | Path] = (), waiting: str = "working"
) -> int:
    """Do the work of a command, write all of its files or none, print its summary.

    Args:
        job: the work; 64-bit JAX is switched on before.
        outputs: what it will write; on failure only JSON and report are, with the reason.
        inputs: files that no output may replace.
        waiting: said on a terminal while it works.

    Returns:
        exit status.
    """
    from jaxmocap.io.atomic import write_many

    try:
        check_places(outputs, inputs)
        use_jax()
        if sys.stderr.isatty():
            print(f"{waiting} (the first run compiles, later ones are faster) ...", file=sys.stderr)
        outcome = job()
        write_many(outcome.files)
    except JaxMocapError as error:
        write_failure(outputs, str(error))
        return failed(str(error), status_of(error))
    print(outcome.summary, end="")
    if outcome.refused:
        return failed(outcome.refused, NOT_SOLVED)
    for sentence in outcome.notes:
        print(f"note: {sentence}")
    if outcome.files:
        print("wrote " + ", ".join(map(str, outcome.files)))
    return DONE


def progress(what: str, unit: str = "photo") -> Callable[[int, int], None] | None:
    """A progress bar on a terminal, nothing elsewhere."""
    if not sys.stderr.isatty():
        return None
    from tqdm import tqdm

    bar = tqdm(desc=what, unit=unit, leave=False)

    def advance(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)
        if done >= total:
            bar.close()

    return advance
