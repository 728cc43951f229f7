"""Thin-lens arithmetic for planning a set-up: how much of the scene a webcam sees from how far."""

from jaxmocap._errors import InputError


def image_distance(focal_length: float, distance: float) -> float:
    """Distance b behind the lens at which an object at distance g in front is sharp, 1/f = 1/g + 1/b.

    Args:
        focal_length: f [any length unit].
        distance: g, in the same unit, larger than f.

    Returns:
        b in that unit.

    Raises:
        InputError: if the object is within the focal length, where a lens forms no real image.
    Source: stop-motion document, eq. 2.1.
    """
    if not 0 < focal_length < distance:
        raise InputError(
            f"distance: expected more than the focal length ({focal_length}), which must be positive, got {distance}"
        )
    return focal_length * distance / (distance - focal_length)


def field_height(focal_length: float, sensor_height: float, distance: float) -> float:
    """Height G of the field that fills a sensor of height B at distance g, G = g B (1/f - 1/g).

    Args:
        focal_length: f [any length unit].
        sensor_height: B, same unit.
        distance: g, same unit.

    Returns:
        G in that unit.

    Raises:
        InputError: as `image_distance`.
    Source: stop-motion document, eq. 2.2; its example f = 4.22, B = 2.44, g = 500 mm is said to give 229 mm.
    """
    return distance * sensor_height / image_distance(focal_length, distance)
