"""The only exceptions that leave a public entry point."""


class JaxMocapError(Exception):
    """Base of all errors jaxmocap raises on purpose."""


class InputError(JaxMocapError, ValueError):
    """The call or its input is wrong: says which argument or file, what was expected and what came."""


class SolveError(JaxMocapError, RuntimeError):
    """The input is well formed but the data cannot be solved: says why and what to record instead."""
