"""Units of length that files may carry."""

from jaxmocap._errors import InputError

METRES = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
"""Physical units that a length may carry, in metres."""


def unit_factor(unit: str, wanted: str, what: str) -> float:
    """By what a length in `unit` is multiplied to be in the unit `wanted`.

    Args:
        unit: unit of the data; "1" is no physical unit.
        wanted: unit of the file.
        what: the argument that asked, for messages.

    Returns:
        the factor; exactly 1 for equal units.

    Raises:
        InputError: for an unknown unit, or if one of the two is physical and the other is not.
    """
    known = (*METRES, "1")
    for name in (unit, wanted):
        if name not in known:
            raise InputError(f"{what}: expected a unit out of {', '.join(METRES)} or 1 (none), got {name!r}.")
    if unit == wanted:
        return 1.0
    if "1" in (unit, wanted):
        raise InputError(
            f"{what}: lengths without a physical unit cannot be converted (from {unit!r} to {wanted!r}). "
            "Give the unit where the data are made, or ask for the unit that they have."
        )
    return METRES[unit] / METRES[wanted]
