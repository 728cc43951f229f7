"""The hierarchy of a skeleton as files need it: one root, no circle, names that can be written."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jaxmocap._errors import InputError

_MAX_DEPTH = 200
"""Readers of nested files recurse; Python's own limit of 1000 calls leaves room for about this many levels."""


@dataclass(frozen=True)
class SkeletonOrder:
    """A checked hierarchy."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """-1 for the root."""
    children: tuple[tuple[int, ...], ...]
    order: tuple[int, ...]
    """Depth first, the root first, children in their order."""


def check_tree(names: Sequence[str], parents: Sequence[int]) -> SkeletonOrder:
    """Check names and parents.

    Args:
        names: of the joints.
        parents: number of each joint's parent, -1 for the root.

    Returns:
        The hierarchy with the order in which files list it.

    Raises:
        InputError: for no joint, double, empty or unwritable names, no or several roots, an unknown parent, a
            circle, more than 200 levels.
    """
    _check_names(names)
    if len(parents) != len(names):
        raise InputError(f"parents: expected {len(names)}, one per joint, got {len(parents)}.")
    above = [int(p) for p in parents]
    for name, parent in zip(names, above):
        if not -1 <= parent < len(names):
            raise InputError(f"parents: joint {name!r} has the unknown parent {parent}; there are {len(names)} joints.")
    roots = [name for name, parent in zip(names, above) if parent < 0]
    if len(roots) > 1:
        raise InputError(f"parents: expected one root, got {len(roots)}: {_list(roots)}. Join them under one joint.")
    children: list[list[int]] = [[] for _ in names]
    for joint, parent in enumerate(above):
        if parent >= 0:
            children[parent].append(joint)
    order: list[int] = []
    waiting = [(above.index(-1), 1)] if roots else []
    while waiting:
        joint, depth = waiting.pop()
        if depth > _MAX_DEPTH:
            raise InputError(f"parents: joint {names[joint]!r} lies more than {_MAX_DEPTH} levels deep; use fewer.")
        order.append(joint)
        waiting += [(child, depth + 1) for child in reversed(children[joint])]
    if len(order) < len(names):
        circle = [name for joint, name in enumerate(names) if joint not in set(order)]
        raise InputError(f"parents: these joints do not hang on a root but on each other in a circle: {_list(circle)}.")
    return SkeletonOrder(tuple(names), tuple(above), tuple(map(tuple, children)), tuple(order))


def unique_words(names: Iterable[str], allowed: str, first: str, taken: Iterable[str] = ()) -> list[str]:
    """Names as words that a file format allows, all different.

    Args:
        names: any texts, all different.
        allowed: characters that may stand in a word, as the inside of a regular expression's brackets; others
            become "_".
        first: those that may stand first; "_" is put before others.
        taken: words that must not be used.

    Returns:
        One word per name; a name that is a good word already is kept.
    """
    names = list(names)
    good = {name for name in names if re.fullmatch(f"[{first}][{allowed}]*", name)} - set(taken)
    used = good | set(taken)
    words = []
    for name in names:
        word = re.sub(f"[^{allowed}]+", "_", name)
        if not re.match(f"[{first}]", word):
            word = "_" + word
        unique, number = word, 2
        while unique in used and name not in good:
            unique, number = f"{word}_{number}", number + 1
        used.add(unique)
        words.append(unique)
    return words


def _check_names(names: Sequence[str]) -> None:
    if not names:
        raise InputError("names: expected at least one joint, got none. There is nothing to write.")
    for number, name in enumerate(names):
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"names: joint {number} has no name ({name!r}).")
        if any(unicodedata.category(c) in ("Cc", "Cs") or c in "\ufffe\uffff" for c in name):
            raise InputError(f"names: joint {number} is called {name!r}, which holds a character no file can store.")
    double = [name for name, times in Counter(names).items() if times > 1]
    if double:
        raise InputError(f"names: two joints are called {double[0]!r}. Give each its own name.")


def _list(names: Sequence[str]) -> str:
    shown = ", ".join(map(repr, names[:6]))
    return shown + (f" and {len(names) - 6} more" if len(names) > 6 else "")
