"""The command line: one file per group of commands, `options` what they share, `run` how each of them ends."""

from jaxmocap.cli.program import main as main
