"""Names of joints as files can hold them."""

import re
import unicodedata
from collections.abc import Iterable

from jaxmocap._errors import InputError


def check_writable(names: Iterable[str]) -> None:
    """Refuse names that XML and JSON cannot hold.

    Raises:
        InputError: for control characters, halves of surrogate pairs, U+FFFE and U+FFFF.
    """
    for number, name in enumerate(names):
        if any(unicodedata.category(c) in ("Cc", "Cs") or c in "\ufffe\uffff" for c in name):
            raise InputError(f"names: joint {number} is called {name!r}, which holds a character no file can store.")


def unique_words(names: Iterable[str], allowed: str, first: str) -> list[str]:
    """Names as words that a file format allows, all different.

    Args:
        names: any texts, all different.
        allowed: characters that may stand in a word, as the inside of a regular expression's brackets; others
            become "_".
        first: those that may stand first; "_" is put before others.

    Returns:
        One word per name; a name that is a good word already is kept.
    """
    names = list(names)
    good = {name for name in names if re.fullmatch(f"[{first}][{allowed}]*", name)}
    used = set(good)
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
